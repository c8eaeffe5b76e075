//! Modules use only those below them. The order is that of ARCHITECTURE.md, written once, in [`LEVELS`].

use std::fs;
use std::path::{Path, PathBuf};

/// The modules of the library, from the ground up. One may use those of lower levels, and itself.
const LEVELS: [&[&str]; 13] = [
    &["machine", "error", "formula", "gather", "reduce", "sweep", "time"],
    &["lanes"],
    &["math"],
    &["kernel", "particles"],
    &["domain", "motion"],
    &["neighbors"],
    &["physics"],
    &["walls", "poisson"],
    &["scheme"],
    &["observe"],
    &["simulation"],
    &["case"],
    &["output"],
];

/// Macros stand at the root of the crate; what they need is in these modules.
const MACROS: [(&str, &str); 1] = [("with_setup", "case")];

fn level(module: &str) -> Option<usize> {
    LEVELS.iter().position(|modules| modules.contains(&module))
}

/// The code of a line: what stands before a comment.
fn code(line: &str) -> &str {
    line.split("//").next().unwrap_or_default()
}

/// Names at the start of the paths that follow `prefix` in `text`, with their lines: `crate::a::b`, `crate::{a, b::{c, d}}`.
fn names_after(text: &str, prefix: &str) -> Vec<(usize, String)> {
    let name = |text: &str| text.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let mut found = Vec::new();
    for (at, _) in text.match_indices(prefix) {
        if text[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':') {
            continue;
        }
        let rest = &text[at + prefix.len()..];
        let line = |offset: usize| text[..at + prefix.len() + offset].matches('\n').count() + 1;
        if !rest.starts_with('{') {
            found.push((line(0), name(rest)));
            continue;
        }
        let mut depth = 0;
        for (offset, c) in rest.char_indices() {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                _ => {}
            }
            if depth == 0 {
                break;
            }
            if depth == 1 && (c == '{' || c == ',') {
                let first = name(&rest[offset + 1..]);
                let space = rest[offset + 1..].len() - rest[offset + 1..].trim_start().len();
                if !first.is_empty() {
                    found.push((line(offset + 1 + space), first));
                }
            }
        }
    }
    found
}

/// Every import of `file` (its path below `src`) that goes up or sideways, as a message.
fn violations(file: &str, text: &str) -> Vec<String> {
    let mut parts = file.trim_end_matches(".rs").split('/');
    let own = parts.next().unwrap_or_default();
    let nested = parts.next().is_some();
    let Some(own_level) = level(own) else {
        return vec![format!("{file}: `{own}` has no level; give it one in `LEVELS` of tests/direction.rs")];
    };
    let text: String = text.lines().flat_map(|line| [code(line), "\n"]).collect();
    let mut names = names_after(&text, "crate::");
    // From a file of a folder two steps up are the root of the crate, from another file one is.
    let up = names_after(&text, if nested { "super::super::" } else { "super::" });
    names.extend(up.into_iter().filter(|(_, name)| level(name).is_some()));
    names.sort();
    let wrong = names.into_iter().filter_map(|(line, name)| {
        let module = MACROS.iter().find(|(known, _)| *known == name).map_or(name.as_str(), |(_, module)| module);
        let problem = match level(module) {
            _ if module == own => return None,
            Some(below) if below < own_level => return None,
            Some(_) => "which is not below it".to_owned(),
            None => "which is no module; import from the module that defines it".to_owned(),
        };
        Some(format!("{file}:{line}: `{own}` uses `crate::{name}`, {problem}"))
    });
    wrong.collect()
}

fn rust_files(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            rust_files(&path, files);
        } else if path.extension().is_some_and(|end| end == "rs") {
            files.push(path);
        }
    }
    files.sort();
}

#[test]
fn modules_use_only_those_below_them() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    rust_files(&root, &mut files);
    let mut wrong = Vec::new();
    let mut seen = 0;
    for path in files {
        let file =
            path.strip_prefix(&root).unwrap().components().map(|part| part.as_os_str().to_string_lossy()).collect::<Vec<_>>().join("/");
        // The root names every module and holds no code.
        if file != "lib.rs" {
            let text = fs::read_to_string(&path).unwrap();
            seen += names_after(&text, "crate::").len();
            wrong.extend(violations(&file, &text));
        }
    }
    assert!(seen > 30, "only {seen} imports found: the search is broken");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn wrong_imports_are_named_by_file_line_and_path() {
    for (file, text, expected) in [
        (
            "domain.rs",
            "use crate::math::Vector;\nuse crate::neighbors::Neighbors;\n",
            "domain.rs:2: `domain` uses `crate::neighbors`, which is not below it",
        ),
        ("walls.rs", "use crate::poisson::CsrMatrix;\n", "walls.rs:1: `walls` uses `crate::poisson`, which is not below it"),
        ("scheme/wcsph.rs", "fn f() {\n    let c = crate::case::Case::load();\n}\n", "scheme/wcsph.rs:2: `scheme` uses `crate::case`"),
        (
            "physics/surface.rs",
            "use crate::{\n    math::{Vector, cube},\n    scheme::Medium,\n};\n",
            "physics/surface.rs:3: `physics` uses `crate::scheme`",
        ),
        ("physics/surface.rs", "use super::super::walls::WallForces;\n", "physics/surface.rs:1: `physics` uses `crate::walls`"),
        ("kernel.rs", "use super::particles::Particles;\n", "kernel.rs:1: `kernel` uses `crate::particles`"),
        ("particles.rs", "use crate::with_setup;\n", "particles.rs:1: `particles` uses `crate::with_setup`"),
        ("scheme.rs", "use crate::Neighbors;\n", "scheme.rs:1: `scheme` uses `crate::Neighbors`, which is no module"),
        ("gpu.rs", "", "gpu.rs: `gpu` has no level"),
    ] {
        let found = violations(file, text).join("\n");
        assert!(found.starts_with(expected) && found.lines().count() == 1, "{file}: {found:?}, expected {expected:?}");
    }
    // Comments, own parts and lower modules are right.
    let fine =
        "//! See [`crate::case::Case`].\nuse crate::scheme::wcsph;\nuse crate::{math::Vector, walls};\nuse $crate::kernel::Kernel;\n";
    assert_eq!(violations("scheme/isph_paper.rs", fine), Vec::<String>::new());
}
