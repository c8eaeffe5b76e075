//! `greenwater cases`, `methods` and `kernels`.

use clap::Args;
use greenwater::case::{reference, shipped_cases};
use greenwater::kernel::KernelName;
use greenwater::scheme::MethodName;
use serde_json::{Value, json};

use crate::console;
use crate::error::CliError;

#[derive(Clone, Copy, Debug, Args)]
pub struct ListArgs {
    /// Print the list as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, Args)]
pub struct CasesArgs {
    /// List every key a case may have, with unit, default and rule
    #[arg(long)]
    keys: bool,
    /// Print the list as JSON
    #[arg(long)]
    json: bool,
}

/// `greenwater cases`.
pub fn cases(args: &CasesArgs) -> Result<(), CliError> {
    if args.keys {
        return keys(args.json);
    }
    let rows = shipped_cases().iter().map(|case| (case.name, case.text().to_owned()));
    list("cases", rows.collect(), args.json)
}

/// `greenwater methods`.
pub fn methods(args: &ListArgs) -> Result<(), CliError> {
    let text = |method: &MethodName| {
        let (kernel, ratio) = method.kernel();
        let kernel =
            if method.takes_kernel() { format!("kernel {}, h = {ratio} spacings", kernel.name()) } else { "a weight of its own".into() };
        format!("{}; {kernel}", method.text())
    };
    list("methods", MethodName::ALL.iter().map(|method| (method.name(), text(method))).collect(), args.json)
}

/// `greenwater kernels`.
pub fn kernels(args: &ListArgs) -> Result<(), CliError> {
    list("kernels", KernelName::ALL.map(|kernel| (kernel.name(), kernel.text().to_owned())).to_vec(), args.json)
}

fn list(what: &str, rows: Vec<(&'static str, String)>, as_json: bool) -> Result<(), CliError> {
    if as_json {
        let rows: Vec<Value> = rows.iter().map(|(name, text)| json!({"name": name, "text": text})).collect();
        return console::print_json(&json!({"format": 1, what: rows}));
    }
    let width = rows.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    let lines: Vec<String> = rows.iter().map(|(name, text)| format!("{name:width$}  {text}")).collect();
    console::print(&lines.join("\n"))
}

fn keys(as_json: bool) -> Result<(), CliError> {
    if as_json {
        return console::print_json(&json!({"format": 1, "keys": reference()}));
    }
    let line = |row: &greenwater::case::KeyRow| {
        let parts = [("unit", &row.unit), ("default", &row.default), ("rule", &row.rule)];
        let given: Vec<String> = parts.iter().filter(|(_, text)| !text.is_empty()).map(|(name, text)| format!("{name} {text}")).collect();
        let details = if given.is_empty() { String::new() } else { format!(" [{}]", given.join("; ")) };
        format!("{} ({}){details}\n    {}", row.key, row.kind, row.text)
    };
    console::print(&reference().iter().map(line).collect::<Vec<_>>().join("\n"))
}
