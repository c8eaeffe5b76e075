//! The reference of the case format, made from the doc comments of [`super::Sections`].

use std::sync::LazyLock;

use schemars::generate::SchemaSettings;
use serde::Serialize;
use serde_json::Value;

use super::method;
use super::sections::Sections;
use super::shape::Shape;
use super::wall_shape;
use crate::scheme::{MethodName, MethodSettings, Preset};

/// A key of the case format.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct KeyRow {
    /// Where it stands: `section.key`, `[]` for each item of a list.
    pub key: String,
    /// Number, whole number, text, list, ...
    pub kind: String,
    /// SI unit; empty for pure numbers and text.
    pub unit: String,
    /// What it is where left out, as TOML; empty if it is required or computed (the text says how).
    pub default: String,
    /// What is allowed; empty if every value of its type is.
    pub rule: String,
    /// What it says.
    pub text: String,
    /// The words it takes, for a key that takes one of a few: each with its meaning.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub choices: Vec<(String, String)>,
}

/// Every key a case may have, in the order of [`Sections`], then the shapes (`shape.box.min`) and the methods (`method(wcsph).alpha`).
pub fn reference() -> &'static [KeyRow] {
    static ROWS: LazyLock<Vec<KeyRow>> = LazyLock::new(|| {
        let mut rows = Vec::new();
        section_rows(&schema(), "", &mut rows);
        wall_rows(&mut rows);
        shape_rows(&mut rows);
        for &name in MethodName::ALL {
            method_rows(name, &mut rows);
        }
        rows
    });
    &ROWS
}

/// The case format as a JSON schema (2020-12), for editors.
pub fn schema() -> Value {
    let settings = SchemaSettings::draft2020_12().with(|settings| settings.inline_subschemas = true);
    settings.into_generator().into_root_schema_for::<Sections>().to_value()
}

/// What the key at `path` says; empty for an unknown key.
pub(super) fn meaning(path: &str) -> String {
    let mut plain = String::new();
    let mut inside = false;
    for c in path.chars() {
        inside = (inside || c == '[') && c != ']';
        if !inside || c == '[' {
            plain.push(c);
        }
    }
    // `walls.shapes[].box.min` is listed as `shape.box.min`.
    if let Some(at) = plain.find(".shapes[].").filter(|_| !reference().iter().any(|row| row.key == plain)) {
        plain = format!("shape.{}", &plain[at + ".shapes[].".len()..]);
    }
    let row = reference().iter().find(|row| row.key == plain);
    row.map(|row| if row.unit.is_empty() { row.text.clone() } else { format!("{} ({})", row.text, row.unit) }).unwrap_or_default()
}

/// The first key of the section `name`; none if it is no table of keys.
pub(super) fn first_key(name: &str) -> Option<&'static str> {
    // `shape` is the list's own word for any of the shapes.
    let is_inside = |row: &&KeyRow| name != "shape" && row.key.strip_prefix(name).is_some_and(|rest| rest.starts_with('.'));
    reference().iter().find(is_inside).map(|row| row.key.as_str())
}

fn section_rows(schema: &Value, prefix: &str, rows: &mut Vec<KeyRow>) {
    let Some(properties) = schema["properties"].as_object() else { return };
    for (name, property) in properties {
        let key = format!("{prefix}{name}");
        let items = &property["items"];
        let is_shape = key.ends_with(".shapes");
        if property["properties"].is_object() {
            section_rows(property, &format!("{key}."), rows);
        } else if items["properties"].is_object() {
            section_rows(items, &format!("{key}[]."), rows);
        } else {
            let kind = if is_shape { "list of shapes".to_owned() } else { kind_of(property) };
            rows.push(row(key, kind, property));
        }
    }
}

/// Shapes occur in several places and inside each other, so they are listed once, as `shape.NAME.key`.
fn shape_rows(rows: &mut Vec<KeyRow>) {
    let schema = schemars::schema_for!(Shape).to_value();
    for variant in schema["oneOf"].as_array().into_iter().flatten() {
        for (name, body) in variant["properties"].as_object().into_iter().flatten() {
            rows.push(KeyRow { kind: "shape".into(), ..row(format!("shape.{name}"), String::new(), variant) });
            for (key, property) in body["properties"].as_object().into_iter().flatten() {
                let key = format!("shape.{name}.{key}");
                let kind = match (&property["$ref"], &property["items"]["$ref"]) {
                    (Value::String(_), _) => "shape".to_owned(),
                    (_, Value::String(_)) => "list of shapes".to_owned(),
                    _ => kind_of(property),
                };
                rows.push(row(key, kind, property));
            }
        }
    }
}

/// Keys that stand beside the shape of a wall.
fn wall_rows(rows: &mut Vec<KeyRow>) {
    for (name, kind, unit, rule, text) in wall_shape::key_rows() {
        let [kind, unit, rule, text] = [kind, unit, rule, text].map(str::to_owned);
        rows.push(KeyRow { key: format!("walls.shapes[].{name}"), kind, unit, default: String::new(), rule, text, choices: Vec::new() });
    }
}

/// The keys of a method. Defaults are those of the preset `water`; where `paper` has another one, the text says so.
fn method_rows(name: MethodName, rows: &mut Vec<KeyRow>) {
    let defaults = |preset| method::table(&MethodSettings::preset(name, preset));
    let (water, paper) = (defaults(Preset::Water), defaults(Preset::Paper));
    let settings = SchemaSettings::draft2020_12().with(|settings| settings.inline_subschemas = true);
    let schema = name.schema(settings.into_generator());
    let first = rows.len();
    section_rows(&schema.to_value(), "", rows);
    rows.retain(|row| row.key != "preset");
    for row in &mut rows[first..] {
        let (default, printed) = (at(&water, &row.key), at(&paper, &row.key));
        if let Some(printed) = printed.filter(|printed| default.as_ref() != Some(printed)) {
            row.text = format!("{} Preset `paper`: `{printed}`.", row.text);
        }
        row.default = default.map(|value| value.to_string()).unwrap_or_default();
        row.key = format!("method({}).{}", name.name(), row.key);
    }
}

/// The value of a dotted key.
fn at<'a>(table: &'a toml::Table, key: &str) -> Option<&'a toml::Value> {
    let mut parts = key.split('.');
    parts.next().and_then(|part| table.get(part)).and_then(|value| parts.try_fold(value, |value, part| value.get(part)))
}

fn row(key: String, kind: String, property: &Value) -> KeyRow {
    let text = |name: &str| one_line(property[name].as_str().unwrap_or_default());
    let variants = present(property)["oneOf"].as_array().into_iter().flatten();
    let choices: Vec<(String, String)> = variants
        .filter_map(|choice| Some((choice["const"].as_str()?.to_owned(), one_line(choice["description"].as_str().unwrap_or_default()))))
        .collect();
    let words: Vec<&str> = choices.iter().map(|(word, _)| word.as_str()).collect();
    let rule = if words.is_empty() { text("rule") } else { format!("one of {}", words.join(", ")) };
    let default = match &property["default"] {
        Value::Null => String::new(),
        value => value.to_string(),
    };
    let kind = if property["kind"].is_string() { text("kind") } else { kind };
    KeyRow { key, kind, unit: text("unit"), default, rule, text: text("description"), choices }
}

/// What a value is where it is given: an optional choice is written as that choice or null.
fn present(property: &Value) -> &Value {
    property["anyOf"].as_array().and_then(|kinds| kinds.iter().find(|kind| kind["type"] != "null")).unwrap_or(property)
}

/// Paragraphs as one line of text.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn kind_of(property: &Value) -> String {
    let name = |kind: &str| {
        match kind {
            "integer" => "whole number",
            "string" => "text",
            "array" => "list",
            "object" => "table",
            other => return other.to_owned(),
        }
        .to_owned()
    };
    let property = present(property);
    match &property["type"] {
        Value::String(kind) if kind == "array" => match &property["items"]["type"] {
            Value::String(inner) => format!("list of {}s", name(inner).replace("text", "name")),
            _ => "list".to_owned(),
        },
        Value::String(kind) => name(kind),
        Value::Array(kinds) => {
            let kind = kinds.iter().filter_map(Value::as_str).find(|kind| *kind != "null").unwrap_or_default();
            if kind == "array" { kind_of(&serde_json::json!({ "type": "array", "items": property["items"] })) } else { name(kind) }
        }
        _ if property["oneOf"].is_array() => "text".to_owned(),
        _ => "table".to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_says_what_it_is() {
        for row in reference() {
            assert!(!row.text.is_empty() && !row.kind.is_empty(), "{row:?}");
        }
    }

    #[test]
    fn the_reference_carries_unit_rule_and_default() {
        let find = |key: &str| reference().iter().find(|row| row.key == key);
        let spacing = find("fluid.spacing").map(|row| (row.kind.as_str(), row.unit.as_str(), row.rule.as_str(), row.default.as_str()));
        assert_eq!(spacing, Some(("number", "m", "> 0", "")));
        assert_eq!(find("time.courant").map(|row| row.default.as_str()), Some("0.25"));
        assert_eq!(find("fluid.density").map(|row| row.default.as_str()), Some("1000.0"));
        assert_eq!(find("shape.tank.open").map(|row| row.kind.as_str()), Some("list of names"));
        assert_eq!(find("domain.min").map(|row| row.kind.as_str()), Some("list of numbers"));
        assert_eq!(find("output.precision").map(|row| row.rule.as_str()), Some("one of float64, float32"));
        assert!(find("probe[].position").is_some());
        let alpha =
            find("method(wcsph).alpha").map(|row| (row.kind.as_str(), row.default.as_str(), row.text.ends_with("Preset `paper`: `1.0`.")));
        assert_eq!(alpha, Some(("number", "0.05", true)));
        assert_eq!(find("method(isph-paper).solver.tolerance").map(|row| row.default.as_str()), Some("0.000001"));
        assert_eq!(find("method(wcsph).initial_density").map(|row| (row.kind.as_str(), row.choices.len())), Some(("text", 2)));
        assert_eq!(find("method(isph-paper).wall_guard").map(|row| row.choices.len()), Some(2));
        assert_eq!(meaning("probe[3].position"), "Where its middle is, one number an axis. (m)");
        assert_eq!(meaning("walls.shapes[0].box.min"), "Lower corner. (m)");
    }

    #[test]
    fn the_schema_refuses_unknown_keys() {
        let schema = schema();
        assert_eq!(schema["properties"]["fluid"]["additionalProperties"], Value::Bool(false));
        assert_eq!(schema["required"][0], "format");
    }
}
