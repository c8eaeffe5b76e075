//! Violent free-surface flow by particle methods.
