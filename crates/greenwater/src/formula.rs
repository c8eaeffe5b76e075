//! Formulas that a user writes: `-0.5*sin(2*pi*x)`, read once, then evaluated without allocating.
//!
//! The usual rules: `^` binds strongest and to the right, then a sign (`-x^2` is `-(x^2)`), then `*` and `/`, then `+` and `-`.
//! A formula is data: it reads its variables and nothing else, and always ends.
//!
//! ```
//! use greenwater::formula::Formula;
//!
//! let formula = Formula::parse("-x^2 + max(y, 0)", &["x", "y"])?;
//! assert_eq!(formula.value(&[3.0, 4.0]), -5.0);
//! # Ok::<(), greenwater::formula::FormulaError>(())
//! ```

use std::f64::consts::PI;

use thiserror::Error;

/// Why a formula cannot be read.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("character {at}: {problem}")]
pub struct FormulaError {
    /// Where, counted in characters from 1.
    pub at: usize,
    /// What was found, and what may stand there.
    pub problem: String,
}

/// A formula of named variables, ready to evaluate.
#[derive(Clone, Debug, PartialEq)]
pub struct Formula {
    text: String,
    program: Vec<Op>,
}

/// A step of the evaluation on a stack of numbers.
#[derive(Clone, Copy, Debug)]
enum Op {
    Number(f64),
    Variable(usize),
    One(fn(f64) -> f64),
    Two(fn(f64, f64) -> f64),
}

impl PartialEq for Op {
    /// The text says which function it is; two formulas of one text are the same.
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::Number(a), Self::Number(b)) => a.to_bits() == b.to_bits(),
            (Self::Variable(a), Self::Variable(b)) => a == b,
            (Self::One(_), Self::One(_)) | (Self::Two(_), Self::Two(_)) => true,
            _ => false,
        }
    }
}

type One = fn(f64) -> f64;
type Two = fn(f64, f64) -> f64;

/// Functions of one number. `step` is 1 above 0 and else 0, `sign` is -1, 0 or 1.
const ONE: [(&str, One); 18] = [
    ("sqrt", f64::sqrt),
    ("exp", f64::exp),
    ("ln", f64::ln),
    ("sin", f64::sin),
    ("cos", f64::cos),
    ("tan", f64::tan),
    ("asin", f64::asin),
    ("acos", f64::acos),
    ("atan", f64::atan),
    ("sinh", f64::sinh),
    ("cosh", f64::cosh),
    ("tanh", f64::tanh),
    ("abs", f64::abs),
    ("floor", f64::floor),
    ("round", f64::round),
    ("step", |x| if x > 0.0 { 1.0 } else { 0.0 }),
    ("sign", |x| if x == 0.0 { 0.0 } else { x.signum() }),
    ("sech", |x| 1.0 / x.cosh()),
];

/// Functions of two numbers.
const TWO: [(&str, Two); 4] = [("min", f64::min), ("max", f64::max), ("atan2", f64::atan2), ("hypot", f64::hypot)];

/// Most numbers on the stack: deeper nesting than anyone writes by hand.
const DEPTH: usize = 32;

impl Formula {
    /// Reads `text`, a formula of the variables `names` and of `pi`.
    ///
    /// # Errors
    /// Where reading stopped, and what may stand there.
    pub fn parse(text: &str, names: &[&str]) -> Result<Self, FormulaError> {
        let mut parser = Parser { text: text.chars().collect(), at: 0, names, program: Vec::new(), height: 0, nesting: 0 };
        parser.sum()?;
        match parser.next() {
            None => Ok(Self { text: text.to_owned(), program: parser.program }),
            Some(c) => parser.fail(format!("`{c}` where an operator (+ - * / ^) or the end may stand")),
        }
    }

    /// The formula as written.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Its value where the variables have `values`, in the order of the names it was read with.
    pub fn value(&self, values: &[f64]) -> f64 {
        let mut stack = [0.0; DEPTH];
        let mut height = 0;
        for op in &self.program {
            match *op {
                Op::Number(number) => {
                    stack[height] = number;
                    height += 1;
                }
                Op::Variable(index) => {
                    stack[height] = values[index];
                    height += 1;
                }
                Op::One(of) => stack[height - 1] = of(stack[height - 1]),
                Op::Two(of) => {
                    height -= 1;
                    stack[height - 1] = of(stack[height - 1], stack[height]);
                }
            }
        }
        stack[0]
    }
}

/// Reads by recursive descent, one function a rank of operators.
struct Parser<'a> {
    text: Vec<char>,
    at: usize,
    names: &'a [&'a str],
    program: Vec<Op>,
    /// Numbers on the stack after the program so far.
    height: usize,
    nesting: usize,
}

impl Parser<'_> {
    /// The next character that is no space.
    fn next(&mut self) -> Option<char> {
        while self.text.get(self.at).is_some_and(|c| c.is_whitespace()) {
            self.at += 1;
        }
        self.text.get(self.at).copied()
    }

    fn take(&mut self, wanted: char) -> bool {
        let found = self.next() == Some(wanted);
        self.at += usize::from(found);
        found
    }

    fn fail<T>(&self, problem: String) -> Result<T, FormulaError> {
        Err(FormulaError { at: self.at + 1, problem })
    }

    fn push(&mut self, op: Op) -> Result<(), FormulaError> {
        match op {
            Op::Number(_) | Op::Variable(_) => self.height += 1,
            Op::One(_) => {}
            Op::Two(_) => self.height -= 1,
        }
        self.program.push(op);
        if self.height > DEPTH {
            self.fail(format!("more than {DEPTH} numbers wait for their operators; split the formula"))
        } else {
            Ok(())
        }
    }

    /// `product + product - ...`
    fn sum(&mut self) -> Result<(), FormulaError> {
        self.nesting += 1;
        if self.nesting > DEPTH {
            return self.fail(format!("more than {DEPTH} parentheses inside each other"));
        }
        self.product()?;
        loop {
            let of: Two = match self.next() {
                Some('+') => |a, b| a + b,
                Some('-') => |a, b| a - b,
                _ => break,
            };
            self.at += 1;
            self.product()?;
            self.push(Op::Two(of))?;
        }
        self.nesting -= 1;
        Ok(())
    }

    /// `signed * signed / ...`
    fn product(&mut self) -> Result<(), FormulaError> {
        self.signed()?;
        loop {
            let of: Two = match self.next() {
                Some('*') => |a, b| a * b,
                Some('/') => |a, b| a / b,
                _ => return Ok(()),
            };
            self.at += 1;
            self.signed()?;
            self.push(Op::Two(of))?;
        }
    }

    /// `power`, `-power`, `+power`
    fn signed(&mut self) -> Result<(), FormulaError> {
        let mut negative = false;
        while let Some(sign @ ('+' | '-')) = self.next() {
            negative ^= sign == '-';
            self.at += 1;
        }
        self.power()?;
        if negative { self.push(Op::One(|x| -x)) } else { Ok(()) }
    }

    /// `value`, `value ^ signed`
    fn power(&mut self) -> Result<(), FormulaError> {
        self.value()?;
        if self.take('^') {
            self.nesting += 1;
            if self.nesting > DEPTH {
                return self.fail(format!("more than {DEPTH} powers inside each other"));
            }
            self.signed()?;
            self.nesting -= 1;
            self.push(Op::Two(f64::powf))?;
        }
        Ok(())
    }

    /// A number, a name, a function with its arguments, or a formula in parentheses.
    fn value(&mut self) -> Result<(), FormulaError> {
        match self.next() {
            Some('(') => {
                self.at += 1;
                self.sum()?;
                self.close()
            }
            Some(c) if c.is_ascii_digit() || c == '.' => self.number(),
            Some(c) if c.is_alphabetic() => self.name(),
            Some(c) => self.fail(format!("`{c}` where a number, a name or `(` must stand")),
            None => self.fail("the formula ends where a number, a name or `(` must stand".to_owned()),
        }
    }

    fn close(&mut self) -> Result<(), FormulaError> {
        if self.take(')') { Ok(()) } else { self.fail("`)` is missing".to_owned()) }
    }

    fn number(&mut self) -> Result<(), FormulaError> {
        let start = self.at;
        let mut end = start;
        while let Some(&c) = self.text.get(end) {
            let sign_of_exponent = matches!(c, '+' | '-') && matches!(self.text[end - 1], 'e' | 'E') && end > start;
            if !(c.is_ascii_digit() || c == '.' || matches!(c, 'e' | 'E') || sign_of_exponent) {
                break;
            }
            end += 1;
        }
        let text: String = self.text[start..end].iter().collect();
        match text.parse::<f64>() {
            Ok(number) if number.is_finite() => {
                self.at = end;
                self.push(Op::Number(number))
            }
            _ => self.fail(format!("`{text}` is no finite number")),
        }
    }

    fn name(&mut self) -> Result<(), FormulaError> {
        let start = self.at;
        let mut end = start;
        while self.text.get(end).is_some_and(|c| c.is_alphanumeric() || *c == '_') {
            end += 1;
        }
        let name: String = self.text[start..end].iter().collect();
        if let Some(index) = self.names.iter().position(|known| *known == name) {
            self.at = end;
            return self.push(Op::Variable(index));
        }
        if name == "pi" {
            self.at = end;
            return self.push(Op::Number(PI));
        }
        let (one, two) = (ONE.iter().find(|(known, _)| *known == name), TWO.iter().find(|(known, _)| *known == name));
        let arguments = match (one, two) {
            (Some(_), _) => 1,
            (_, Some(_)) => 2,
            _ => {
                let functions: Vec<&str> = ONE.iter().map(|(name, _)| *name).chain(TWO.iter().map(|(name, _)| *name)).collect();
                let variables: Vec<&str> = self.names.iter().copied().chain(["pi"]).collect();
                return self.fail(format!(
                    "unknown name `{name}`; known: {} and the functions {}",
                    variables.join(", "),
                    functions.join(", ")
                ));
            }
        };
        self.at = end;
        if !self.take('(') {
            return self.fail(format!("`{name}` is a function and needs `(` after it"));
        }
        self.sum()?;
        if arguments == 2 {
            if !self.take(',') {
                return self.fail(format!("`{name}` takes two arguments with a comma between"));
            }
            self.sum()?;
        }
        self.close()?;
        match (one, two) {
            (Some(&(_, of)), _) => self.push(Op::One(of)),
            (_, Some(&(_, of))) => self.push(Op::Two(of)),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(text: &str) -> f64 {
        Formula::parse(text, &["x", "y"]).unwrap_or_else(|e| panic!("{text}: {e}")).value(&[3.0, 2.0])
    }

    #[test]
    fn operators_bind_as_in_print() {
        for (text, expected) in [
            ("1 + 2*3", 7.0),
            ("-x^2", -9.0),
            ("2^-1", 0.5),
            ("2^3^2", 512.0),
            ("-2^2*y", -8.0),
            ("8/4/2", 1.0),
            ("5 - 3 - 1", 1.0),
            ("x*-y", -6.0),
            ("--x", 3.0),
            ("(1 + 2)*3", 9.0),
            ("1.5e-1*x", 3.0 * 0.15),
            ("2e2", 200.0),
            ("max(x, y) + min(x, y)", 5.0),
            ("step(x) + step(-x) + sign(0)", 1.0),
            ("hypot(x+1, 1+y)", 5.0),
            ("abs(-y)*cos(0)", 2.0),
        ] {
            assert_eq!(value(text), expected, "{text}");
        }
        assert_eq!(value("sin(pi*x/6)"), (PI * 3.0 / 6.0).sin());
    }

    #[test]
    fn what_cannot_be_read_is_named_with_its_place() {
        for (text, at, part) in [
            ("", 1, "ends where a number"),
            ("1 +", 4, "ends where a number"),
            ("2 x", 3, "an operator"),
            ("(x", 3, "`)` is missing"),
            ("vx + 1", 1, "unknown name `vx`; known: x, y, pi and the functions sqrt"),
            ("sin x", 5, "needs `(`"),
            ("max(x)", 6, "two arguments"),
            ("1e999", 1, "no finite number"),
            ("1..2", 1, "no finite number"),
            ("x $ y", 3, "`$`"),
            ("x +* y", 4, "`*` where a number"),
        ] {
            let error = Formula::parse(text, &["x", "y"]).expect_err(text);
            assert!(error.at == at && error.problem.contains(part), "{text}: {error}");
        }
        let deep = "(".repeat(40) + "x" + &")".repeat(40);
        assert!(Formula::parse(&deep, &["x"]).is_err());
        let long = "1+(".repeat(40) + "x" + &")".repeat(40);
        assert!(Formula::parse(&long, &["x"]).is_err());
        assert!(Formula::parse(&("2^".repeat(5000) + "2"), &[]).is_err());
    }
}
