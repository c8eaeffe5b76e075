//! Tables of particles: the initial state of a case from a file.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use super::error::{CaseError, Choices};
use super::shape::AXES;
use crate::math::Vector;
use crate::particles::{Kind, Particle, field_table};

/// The numbers of a table, after `id` and `kind`.
fn number_columns(dimension: usize) -> Vec<String> {
    let axes = &AXES[..dimension];
    let mut names: Vec<String> = axes.iter().map(char::to_string).collect();
    names.extend(axes.iter().map(|axis| format!("v{axis}")));
    names.extend(["density", "pressure", "mass", "h"].map(String::from));
    names
}

/// A row of a table: identity, state and the line it stood in (counted from 1).
pub(super) type Row<const D: usize> = (u32, Particle<D>, usize);

/// Reads the table at `path`: one header line (columns of further fields, as `greenwater export --all-fields` adds them, are skipped), a row a particle, numbers in SI units. At most `limit` rows.
///
/// # Errors
/// Unreadable files; missing, unknown or repeated columns; ragged rows; numbers that are not finite; `density`, `mass` or `h`
/// not above 0; an identity twice; more rows than `limit`.
pub(super) fn read<const D: usize>(path: &Path, limit: u64) -> Result<Vec<Row<D>>, CaseError> {
    let unreadable = |source| CaseError::Unreadable { path: path.to_owned(), source };
    let file = path.display().to_string();
    let input = std::fs::File::open(path).map_err(unreadable)?;
    if !input.metadata().map_err(unreadable)?.is_file() {
        return Err(unreadable(std::io::Error::new(std::io::ErrorKind::InvalidInput, "not a file")));
    }
    parse(&file, BufReader::new(input), limit).map_err(|error| match error {
        Problem::Io(source) => unreadable(source),
        Problem::Case(error) => error,
    })
}

enum Problem {
    Io(std::io::Error),
    Case(CaseError),
}

impl From<CaseError> for Problem {
    fn from(error: CaseError) -> Self {
        Self::Case(error)
    }
}

/// Longest line of a table, bytes: 13 numbers of 17 digits need 350.
const LONGEST_LINE: u64 = 4096;

fn parse<const D: usize>(file: &str, mut input: impl BufRead, limit: u64) -> Result<Vec<Row<D>>, Problem> {
    let table = |row: usize, problem: String| CaseError::ParticleTable { file: file.to_owned(), row, problem };
    let mut line = String::new();
    let mut next = |row: usize, line: &mut String| -> Result<bool, Problem> {
        line.clear();
        let read = input.by_ref().take(LONGEST_LINE).read_line(line).map_err(Problem::Io)?;
        if read as u64 == LONGEST_LINE {
            return Err(
                table(row, format!("this line is longer than {LONGEST_LINE} bytes; a table of particles has one row a line")).into()
            );
        }
        Ok(read > 0)
    };

    next(1, &mut line)?;
    let header: Vec<String> = line.trim().trim_start_matches('\u{feff}').split(',').map(column_name).collect();
    let numbers = number_columns(D);
    let mut required = vec!["id".to_owned(), "kind".to_owned()];
    required.extend(numbers.iter().cloned());
    let find = |name: &str| header.iter().position(|column| column == name);
    if let Some(missing) = required.iter().find(|name| find(name).is_none()) {
        return Err(table(1, format!("column `{missing}` is missing; the columns are {}", required.join(","))).into());
    }
    for (i, name) in header.iter().enumerate() {
        if name != "layer" && !required.contains(name) && !is_field(name) {
            let hint = Choices::new(name, ["layer"]).hint();
            return Err(
                table(1, format!("unknown column `{name}`{hint}; the columns are {} and, if wanted, layer", required.join(","))).into()
            );
        }
        if header[..i].contains(name) {
            return Err(table(1, format!("column `{name}` stands there twice")).into());
        }
    }
    let index: Vec<usize> = required.iter().filter_map(|name| find(name)).collect();
    let layer_column = find("layer");

    let mut rows: Vec<Row<D>> = Vec::new();
    for row in 2.. {
        if !next(row, &mut line)? {
            break;
        }
        if line.trim().is_empty() {
            continue;
        }
        if rows.len() as u64 == limit {
            return Err(table(
                row,
                format!("more than {limit} particles, which is what `limits` allows; raise `limits.particles` or `limits.memory_gib`"),
            )
            .into());
        }
        let cells: Vec<&str> = line.trim().split(',').map(str::trim).collect();
        if cells.len() != header.len() {
            return Err(table(row, format!("{} values, but the header names {} columns", cells.len(), header.len())).into());
        }
        let wrong = |column: &str, value: &str, rule: &str| CaseError::ParticleValue {
            file: file.to_owned(),
            row,
            column: column.to_owned(),
            value: if value.is_empty() { "empty".to_owned() } else { value.to_owned() },
            rule: rule.to_owned(),
        };
        let mut values = [0.0; 10];
        for (slot, (name, &column)) in values.iter_mut().zip(numbers.iter().zip(&index[2..])) {
            let text = cells[column];
            let value: f64 = text.parse().map_err(|_| wrong(name, text, "a number"))?;
            if !value.is_finite() {
                return Err(wrong(name, text, "a finite number").into());
            }
            *slot = value;
        }
        let [density, pressure, mass, h] = [0, 1, 2, 3].map(|i| values[2 * D + i]);
        for (name, value) in [("density", density), ("mass", mass), ("h", h)] {
            if value <= 0.0 {
                return Err(wrong(name, &value.to_string(), "> 0").into());
            }
        }
        let id = cells[index[0]].parse().map_err(|_| wrong("id", cells[index[0]], "a whole number from 0 to 4294967295"))?;
        let kind = match cells[index[1]] {
            "fluid" => Kind::Fluid,
            "wall" => Kind::Wall,
            other => return Err(wrong("kind", other, "fluid or wall").into()),
        };
        let layer = match (kind, layer_column) {
            (Kind::Wall, None) => 1,
            (Kind::Wall, Some(column)) => match cells[column].parse() {
                Ok(layer) if layer > 0 => layer,
                _ => return Err(wrong("layer", cells[column], "a whole number from 1 to 255 for a wall particle").into()),
            },
            _ => 0,
        };
        let (x, v) = (Vector(std::array::from_fn(|d| values[d])), Vector(std::array::from_fn(|d| values[D + d])));
        rows.push((id, Particle { kind, layer, x, v, mass, density, pressure, h }, row));
    }

    let mut ids: Vec<(u32, usize)> = rows.iter().map(|&(id, _, row)| (id, row)).collect();
    ids.sort_unstable();
    if let Some(pair) = ids.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        return Err(wrong_id(file, pair[1], pair[0].1).into());
    }
    Ok(rows)
}

fn wrong_id(file: &str, (id, row): (u32, usize), first: usize) -> CaseError {
    CaseError::ParticleValue {
        file: file.to_owned(),
        row,
        column: "id".to_owned(),
        value: id.to_string(),
        rule: format!("unique; row {first} has the same"),
    }
}

/// Whether `name` is a column that an export may add and a case has no use for: a field of frames, vectors as `name_x`.
fn is_field(name: &str) -> bool {
    let plain = AXES.iter().find_map(|axis| name.strip_suffix(&format!("_{axis}"))).unwrap_or(name);
    field_table::<3>().iter().any(|field| field.name == plain)
}

/// A column's name without the unit (`x [m]`) that some tables give.
fn column_name(cell: &str) -> String {
    cell.split('[').next().unwrap_or_default().trim().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEADER: &str = "id,kind,x,y,vx,vy,density,pressure,mass,h\n";

    fn message(text: &str) -> String {
        match parse::<2>("p.csv", text.as_bytes(), 3) {
            Err(Problem::Case(error)) => error.to_string(),
            Err(Problem::Io(error)) => error.to_string(),
            Ok(rows) => format!("{} rows", rows.len()),
        }
    }

    #[test]
    fn every_column_reaches_its_field_in_any_order() {
        let text = "h,mass,pressure,density,vy [m/s],vx [m/s],y,x,layer,kind,id\n1,2,3,4,5,6,7,8,2,wall,9\r\n1,2,3,4,5,6,7,8,,fluid,10\n";
        let Ok(rows) = parse::<2>("p.csv", text.as_bytes(), 3) else { panic!("{}", message(text)) };
        let wall = Particle {
            kind: Kind::Wall,
            layer: 2,
            x: Vector([8.0, 7.0]),
            v: Vector([6.0, 5.0]),
            mass: 2.0,
            density: 4.0,
            pressure: 3.0,
            h: 1.0,
        };
        assert_eq!(rows, [(9, wall, 2), (10, Particle { kind: Kind::Fluid, layer: 0, ..wall }, 3)]);
    }

    #[test]
    fn bad_tables_are_named_by_row_and_column() {
        for (rows, expected) in [
            ("0,fluid,0,0,NaN,0,1000,0,1,0.1\n", "p.csv:2: column `vx` is NaN, but must be a finite number"),
            ("0,fluid,0,0,0,0,1000,0,1,0.1\n1,fluid,0,inf,0,0,1000,0,1,0.1\n", "p.csv:3: column `y` is inf, but must be a finite number"),
            ("0,fluid,0,0,0,0,1000,0,1\n", "p.csv:2: 9 values, but the header names 10 columns"),
            ("0,fluid,0,0,0,0,1000,0,0,0.1\n", "p.csv:2: column `mass` is 0, but must be > 0"),
            ("0,fluid,0,0,0,0,1000,0,1,-0.1\n", "p.csv:2: column `h` is -0.1, but must be > 0"),
            ("0,gas,0,0,0,0,1000,0,1,0.1\n", "p.csv:2: column `kind` is gas, but must be fluid or wall"),
            ("-1,fluid,0,0,0,0,1000,0,1,0.1\n", "p.csv:2: column `id` is -1"),
            ("0,fluid,abc,0,0,0,1000,0,1,0.1\n", "p.csv:2: column `x` is abc, but must be a number"),
            ("0,fluid,,0,0,0,1000,0,1,0.1\n", "p.csv:2: column `x` is empty, but must be a number"),
            ("4,fluid,0,0,0,0,1,0,1,1\n4,fluid,1,0,0,0,1,0,1,1\n", "p.csv:3: column `id` is 4, but must be unique; row 2 has the same"),
        ] {
            let found = message(&format!("{HEADER}{rows}"));
            assert!(found.contains(expected), "{found}");
        }
        assert!(message("id,kind,x,y,vx,vy,density,pressure,mass\n").contains("p.csv:1: column `h` is missing"));
        assert!(message(&HEADER.replace("h\n", "h,layr\n")).contains("unknown column `layr`, did you mean `layer`?"));
        assert!(message(&HEADER.replace("h\n", "h,h\n")).contains("column `h` stands there twice"));
        assert!(message("").contains("column `id` is missing"));
        let four: String = (0..4).map(|i| format!("{i},fluid,{i},0,0,0,1,0,1,1\n")).collect();
        assert!(message(&format!("{HEADER}{four}")).contains("more than 3 particles"));
        assert!(message(&"x".repeat(5000)).contains("longer than 4096 bytes"));
    }
}
