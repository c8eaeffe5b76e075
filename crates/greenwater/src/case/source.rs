//! The text of a case: reading it, applying `--set`, and finding the line of a key.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use toml::Value;
use toml::de::{DeTable, DeValue};

use super::error::{CaseError, Choices, Place};
use super::reference::{first_key, meaning};
use super::sections::Method;
use crate::scheme::{MethodName, MethodSettings};

/// The text of a case and where it came from.
#[derive(Clone, Debug)]
pub(super) struct Source {
    /// The file as the user named it.
    pub file: String,
    /// What it says.
    pub text: String,
    /// The only folder the case may read from; none for shipped cases.
    pub folder: Option<PathBuf>,
    /// `key=value` of the command line, applied in this order.
    pub overrides: Vec<(String, String)>,
}

impl Source {
    /// The case as a table, with the overrides applied. Every number in it is finite.
    pub fn table(&self) -> Result<toml::Table, CaseError> {
        let mut table: toml::Table = toml::from_str(&self.text).map_err(|e| self.syntax(&e))?;
        for (key, text) in &self.overrides {
            set(&mut table, key, text)?;
        }
        self.check_sections("", &table)?;
        self.check_finite("", &Value::Table(table.clone()))?;
        Ok(table)
    }

    /// Reads `value`, which stands under `prefix`, as a `T`.
    pub fn read<T: DeserializeOwned>(&self, prefix: &str, value: Value) -> Result<T, CaseError> {
        self.explained(prefix, serde_path_to_error::deserialize(value))
    }

    /// Reads the parameters of a method, which stand under `method`.
    pub fn read_method(&self, name: MethodName, value: Value) -> Result<MethodSettings, CaseError> {
        let mut track = serde_path_to_error::Track::new();
        let reader = serde_path_to_error::Deserializer::new(value, &mut track);
        let read = MethodSettings::read(name, reader);
        self.explained("method", read.map_err(|error| serde_path_to_error::Error::new(track.path(), error)))
    }

    /// A method with nothing but what the overrides say of `[method]`.
    pub fn overridden_method(&self, name: MethodName) -> Result<Method, CaseError> {
        let mut table = toml::Table::new();
        for (key, text) in &self.overrides {
            if let Some(key) = key.strip_prefix("method.") {
                set(&mut table, key, text)?;
            }
        }
        table.insert("name".to_owned(), Value::String(name.name().to_owned()));
        self.read("method", Value::Table(table))
    }

    /// Says where what could not be read stands, for values under `prefix`.
    fn explained<T>(&self, prefix: &str, read: Result<T, serde_path_to_error::Error<toml::de::Error>>) -> Result<T, CaseError> {
        read.map_err(|e| {
            let path = e.path().to_string();
            let key = match (prefix, path.as_str()) {
                ("", path) => path.to_owned(),
                (prefix, ".") => prefix.to_owned(),
                (prefix, path) => format!("{prefix}.{path}"),
            };
            self.explain(&key, e.inner().message())
        })
    }

    /// A broken rule: what stands at `key`, and what is allowed there.
    pub fn broken(&self, key: &str, value: impl ToString, rule: impl Into<String>) -> CaseError {
        CaseError::Rule { place: self.place(key), key: key.to_owned(), value: value.to_string(), rule: rule.into() }
    }

    /// An error unless `holds`.
    pub fn rule(&self, holds: bool, key: &str, value: impl ToString, rule: impl Into<String>) -> Result<(), CaseError> {
        if holds { Ok(()) } else { Err(self.broken(key, value, rule)) }
    }

    /// Where the key at `path` (`probe[0].position`) stands, or the nearest table around it.
    pub fn place(&self, path: &str) -> Place {
        let inside = |key: &str| path == key || path.strip_prefix(key).is_some_and(|rest| rest.starts_with(['.', '[']));
        if let Some((key, value)) = self.overrides.iter().rev().find(|(key, _)| inside(key)) {
            return Place::Override(format!("{key}={value}"));
        }
        match DeTable::parse(&self.text).ok().and_then(|root| offset_of(root.get_ref(), path)) {
            Some(offset) => self.line(offset),
            None => Place::File(self.file.clone()),
        }
    }

    fn line(&self, offset: usize) -> Place {
        let line = 1 + self.text.bytes().take(offset).filter(|&byte| byte == b'\n').count();
        Place::Line { file: self.file.clone(), line }
    }

    fn syntax(&self, error: &toml::de::Error) -> CaseError {
        let place = error.span().map_or_else(|| Place::File(self.file.clone()), |span| self.line(span.start));
        let mut problem = error.message().replace('\n', "; ");
        if problem.starts_with("duplicate key") {
            problem += "; a section stands once, lists of tables are written `[[probe]]`";
        }
        CaseError::Syntax { place, problem }
    }

    fn check_finite(&self, path: &str, value: &Value) -> Result<(), CaseError> {
        match value {
            Value::Float(number) => self.rule(number.is_finite(), path, number, "a finite number"),
            Value::Array(items) => items.iter().enumerate().try_for_each(|(i, item)| self.check_finite(&format!("{path}[{i}]"), item)),
            Value::Table(table) => table.iter().try_for_each(|(key, item)| {
                let path = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                self.check_finite(&path, item)
            }),
            _ => Ok(()),
        }
    }

    /// No section and no shape is a list: serde would take that for the values of its keys in their order.
    fn check_sections(&self, path: &str, table: &toml::Table) -> Result<(), CaseError> {
        table.iter().try_for_each(|(name, value)| {
            let key = join(path, name);
            let first = if path.contains("shapes[") { first_key(&format!("shape.{name}")) } else { first_key(&key) };
            match (value, first) {
                (Value::Table(inner), _) => self.check_sections(&key, inner),
                (Value::Array(_), Some(first)) => {
                    let problem = format!("list, expected a table, with keys such as `{}`", first.trim_start_matches("shape."));
                    Err(CaseError::WrongType { place: self.place(&key), key, problem })
                }
                (Value::Array(items), None) => {
                    let mut tables = items.iter().enumerate().filter_map(|(i, item)| Some((i, item.as_table()?)));
                    tables.try_for_each(|(i, item)| self.check_sections(&format!("{key}[{i}]"), item))
                }
                _ => Ok(()),
            }
        })
    }

    /// Says in the user's words what serde found wrong at `path`.
    fn explain(&self, path: &str, message: &str) -> CaseError {
        let place = self.place(path);
        let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
        let (name, known) = match quoted.split_first() {
            Some((name, known)) => (*name, known),
            None => ("", [].as_slice()),
        };
        let choices = Choices::new(name, known.iter().copied());
        if message.starts_with("unknown field") {
            let key = if last_name(path) == name { path.to_owned() } else { join(path, name) };
            CaseError::UnknownKey { place, key, choices }
        } else if message.starts_with("unknown variant") {
            CaseError::UnknownChoice { place, key: path.to_owned(), value: name.to_owned(), choices }
        } else if message.starts_with("missing field") {
            let key = join(path, name);
            let meaning = meaning(&key);
            CaseError::Missing { place, key, meaning }
        } else {
            CaseError::WrongType { place, key: path.to_owned(), problem: plain_words(message) }
        }
    }
}

fn join(path: &str, name: &str) -> String {
    if path.is_empty() || path == "." { name.to_owned() } else { format!("{path}.{name}") }
}

fn last_name(path: &str) -> &str {
    path.rsplit('.').next().unwrap_or(path)
}

/// Serde's words for types, said as a user of TOML would.
fn plain_words(message: &str) -> String {
    let mut text = message.replace("invalid type: ", "").replace("invalid value: ", "").replace("floating point", "number");
    for (word, plain) in [
        ("expected f64", "expected a number in SI units, without quotes or a unit"),
        ("expected u32", "expected a whole number >= 0"),
        ("expected u64", "expected a whole number >= 0"),
        ("expected a sequence", "expected a list"),
        ("expected a map", "expected a table"),
        ("sequence", "list"),
        ("unit variant", "a name alone"),
        ("map,", "table,"),
    ] {
        text = text.replace(word, plain);
    }
    match text.find("expected struct") {
        Some(at) => format!("{}expected a table", &text[..at]),
        None => text,
    }
}

/// Byte offset of the key at `path`, or of the innermost part of the path that the text has.
fn offset_of(root: &DeTable<'_>, path: &str) -> Option<usize> {
    let mut found = None;
    let mut table = Some(root);
    let mut array = None;
    for segment in path.split(['.', '[']) {
        let value = if let Some(index) = segment.strip_suffix(']') {
            let item = array.take().and_then(|items: &toml::de::DeArray<'_>| items.get(index.parse::<usize>().ok()?));
            found = item.map(|value| value.span().start).or(found);
            item
        } else {
            let entry = table.take().and_then(|entries| entries.iter().find(|(key, _)| key.get_ref().as_ref() == segment));
            found = entry.map(|(key, _)| key.span().start).or(found);
            entry.map(|(_, value)| value)
        };
        match value.map(|value| value.get_ref()) {
            Some(DeValue::Table(inner)) => table = Some(inner),
            Some(DeValue::Array(inner)) => array = Some(inner),
            _ => break,
        }
    }
    found
}

/// Puts `text` at `key` (`section.key`, list items as `probe[0].name`), as TOML if it is TOML, else as a string.
fn set(table: &mut toml::Table, key: &str, text: &str) -> Result<(), CaseError> {
    let wrong = |problem: String| CaseError::Override { text: format!("{key}={text}"), problem };
    let value = match toml::from_str::<toml::Table>(&format!("value = {text}")) {
        Ok(mut parsed) if parsed.len() == 1 => parsed.remove("value").unwrap_or_else(|| Value::String(text.to_owned())),
        _ => Value::String(text.to_owned()),
    };
    let names: Vec<&str> = key.split('.').collect();
    if names.iter().any(|name| name.is_empty()) {
        return Err(wrong("a part of the key is empty".to_owned()));
    }
    let mut slot: Option<&mut Value> = None;
    let mut root = Some(table);
    for segment in names {
        let mut parts = segment.split('[');
        let name = parts.next().unwrap_or_default();
        let parent = match (root.take(), slot) {
            (Some(root), _) => root,
            (None, Some(Value::Table(inner))) => inner,
            _ => return Err(wrong(format!("`{name}` cannot be set inside something that is not a table"))),
        };
        let mut here = parent.entry(name).or_insert_with(|| Value::Table(toml::Table::new()));
        for index in parts {
            let found = index.strip_suffix(']').and_then(|digits| digits.parse::<usize>().ok());
            here = match (found, here) {
                (Some(i), Value::Array(items)) if i < items.len() => &mut items[i],
                _ => return Err(wrong(format!("the case has no `{segment}`"))),
            };
        }
        slot = Some(here);
    }
    if let Some(slot) = slot {
        *slot = value;
    }
    Ok(())
}

/// `folder/name`, if that is a file inside the folder.
pub(super) fn inside(folder: &Path, name: &str) -> std::io::Result<Option<PathBuf>> {
    let path = folder.join(name);
    let (root, real) = (folder.canonicalize()?, path.canonicalize()?);
    Ok(real.starts_with(root).then_some(path))
}
