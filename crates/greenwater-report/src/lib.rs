//! Reports from run folders: HTML, SVG, PNG and JSON.
