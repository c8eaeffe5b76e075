//! The history: a file with one line a call of `greenwater bench`, each a whole JSON document with its machine, commit and date.

use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::Path;

use super::BenchError;
use super::record::Document;

/// Adds a line.
pub fn append(path: &Path, document: &Document) -> Result<(), BenchError> {
    let failed = |action| move |source| BenchError::Io { action, path: path.to_owned(), source };
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).map_err(failed("create the folder of"))?;
    }
    let mut file = OpenOptions::new().create(true).append(true).open(path).map_err(failed("open"))?;
    file.write_all(format!("{}\n", document.line()).as_bytes()).map_err(failed("write"))
}

/// Every line, oldest first; none for a file that does not exist yet.
pub fn read(path: &Path) -> Result<Vec<Document>, BenchError> {
    let text = match fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(BenchError::Io { action: "read", path: path.to_owned(), source }),
    };
    let document = |(i, line): (usize, &str)| {
        Document::parse(line).map_err(|problem| BenchError::History { path: path.to_owned(), line: i + 1, problem })
    };
    text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()).map(document).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::record::{Record, Seconds};
    use serde_json::{Map, json};

    #[test]
    fn lines_come_back_as_they_were_and_a_broken_one_is_named() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("deep/history.jsonl");
        assert_eq!(read(&path).expect("no file, no lines"), []);
        let record = |workload: &str| Record {
            bench: "step".into(),
            workload: workload.into(),
            seconds: Some(Seconds::of(&[0.1, 0.25])),
            phases: [("forces".into(), 0.5)].into(),
            extra: Map::from_iter([("flow_time".to_owned(), json!(0.125))]),
            ..Record::default()
        };
        let documents: Vec<Document> =
            ["one", "two"].map(|name| Document::new(vec![record(name)], Map::from_iter([("commit".to_owned(), json!("abc"))]))).into();
        for document in &documents {
            append(&path, document).expect("writable");
        }
        assert_eq!(read(&path).expect("sound"), documents);
        fs::write(&path, format!("{}\n{{\"format\": 2}}\n", documents[0].line())).expect("writable");
        let error = read(&path).expect_err("line 2 is broken").to_string();
        assert!(error.contains("line 2"), "{error}");
    }
}
