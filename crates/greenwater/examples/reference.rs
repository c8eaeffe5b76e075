//! Prints the reference of the case format, `docs/src/reference/case.md`, from the doc comments of the code:
//!
//! `cargo run -p greenwater --example reference > docs/src/reference/case.md`

use std::fmt::Write;

use greenwater::case::{KeyRow, reference};
use greenwater::kernel::KernelName;
use greenwater::particles::field_table;
use greenwater::scheme::MethodName;

/// The page, Markdown.
pub fn page() -> String {
    let mut page = String::from(
        "# Case format\n\n\
         <!-- Made by `cargo run -p greenwater --example reference > docs/src/reference/case.md`. Edit the doc comments, not this page. -->\n\n\
         A case is a TOML file, `case.toml`, in UTF-8. All numbers are in SI units. Keys that are not listed here are errors.\n\
         `[]` stands for each item of a list. The keys of one section:\n\n",
    );
    let (methods, rest): (Vec<&KeyRow>, Vec<&KeyRow>) = reference().iter().partition(|row| row.key.starts_with("method("));
    let (shapes, keys): (Vec<&KeyRow>, Vec<&KeyRow>) = rest.into_iter().partition(|row| row.key.starts_with("shape."));
    table_of_keys(&mut page, &keys);
    page.push_str("\n## Shapes\n\nWhat `fluid.shapes` and `walls.shapes` take: `{ box = { min = [0.0, 0.0], max = [1.0, 1.0] } }`.\n\n");
    table_of_keys(&mut page, &shapes);
    for method in MethodName::ALL.iter().copied() {
        let prefix = format!("method({}).", method.name());
        let _ = write!(page, "\n## Method `{}`\n\n{}: {}. Keys of `[method]`:\n\n", method.name(), method.title(), method.text());
        let own = methods.iter().filter(|row| row.key.starts_with(&prefix));
        let own: Vec<KeyRow> = own.map(|row| KeyRow { key: row.key[prefix.len()..].to_owned(), ..(*row).clone() }).collect();
        table_of_keys(&mut page, &own.iter().collect::<Vec<_>>());
    }
    page.push_str("\n## Kernels\n\nWhat `kernel.name` takes.\n\n| name | support / h | what it is |\n|---|---|---|\n");
    for kernel in KernelName::ALL {
        let _ = writeln!(page, "| `{}` | {} | {} |", kernel.name(), kernel.radius(), cell(kernel.text()));
    }
    page.push_str("\n## Fields\n\nWhat `output.fields` takes. Units of a 2D case are per metre of depth.\n\n");
    page.push_str("| name | unit in 2D | unit in 3D | what it is |\n|---|---|---|---|\n");
    for (plane, space) in field_table::<2>().iter().zip(field_table::<3>()) {
        let _ = writeln!(page, "| `{}` | {} | {} | {} |", plane.name, plane.unit, space.unit, cell(plane.text));
    }
    page
}

fn table_of_keys(page: &mut String, rows: &[&KeyRow]) {
    page.push_str("| key | takes | unit | default | what it is |\n|---|---|---|---|---|\n");
    for row in rows {
        let default = if row.default.is_empty() { String::new() } else { format!("`{}`", cell(&row.default)) };
        let takes = if row.rule.is_empty() { row.kind.clone() } else { format!("{}, {}", row.kind, row.rule) };
        let mut text = row.text.clone();
        for (word, meaning) in &row.choices {
            let _ = write!(text, "<br>`{word}`: {meaning}");
        }
        let _ = writeln!(page, "| `{}` | {} | {} | {default} | {} |", row.key, cell(&takes), row.unit, cell(&text));
    }
}

/// Text that may stand in a cell of a table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|")
}

#[allow(dead_code)] // The test of the docs takes this file as a module.
fn main() {
    print!("{}", page());
}
