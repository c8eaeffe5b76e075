//! A wall shape with what only walls have: a name, and how it moves.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeSeed, Deserializer, EnumAccess, Error, MapAccess, VariantAccess, Visitor};
use serde::{Deserialize, Serialize};

use super::shape::{SHAPE_NAMES, Shape};

/// A formula as written. A number stands for itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct Written(pub String);

impl<'de> Deserialize<'de> for Written {
    fn deserialize<T: Deserializer<'de>>(deserializer: T) -> Result<Self, T::Error> {
        struct Text;
        impl Visitor<'_> for Text {
            type Value = Written;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a formula in quotes, or a number")
            }
            fn visit_str<E: Error>(self, text: &str) -> Result<Written, E> {
                Ok(Written(text.to_owned()))
            }
            fn visit_f64<E: Error>(self, number: f64) -> Result<Written, E> {
                Ok(Written(number.to_string()))
            }
            fn visit_i64<E: Error>(self, number: i64) -> Result<Written, E> {
                Ok(Written(number.to_string()))
            }
        }
        deserializer.deserialize_any(Text)
    }
}

/// A wall of a case: a shape, and what else may stand beside it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WallShape {
    /// Its name in `load.walls`, `probe.on` and `gauge.on`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Its velocity as formulas of the time `t` in s, m/s, one an axis; left out: at rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocity: Option<Vec<Written>>,
    /// Whether its particles go along with its velocity; `false`: it slides and stays, like the belt of a lid.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub moves: Option<bool>,
    /// The shape.
    #[serde(flatten)]
    pub shape: Shape,
}

/// The keys beside the shape, with kind, unit, rule and text.
const KEYS: [(&str, &str, &str, &str, &str); 3] = [
    ("name", "text", "", "letters, digits, `.`, `_`, `-`; unique", "Its name in `load.walls`, `probe.on` and `gauge.on`."),
    (
        "velocity",
        "list of formulas",
        "m/s",
        "of t in s; one an axis",
        "Its velocity; left out: at rest. At the start it has the velocity at t = 0.",
    ),
    (
        "moves",
        "boolean",
        "",
        "",
        "Whether its particles go along with its velocity; `false`: it slides and stays, like the belt of a lid; left out: `true`.",
    ),
];

impl<'de> Deserialize<'de> for WallShape {
    fn deserialize<T: Deserializer<'de>>(deserializer: T) -> Result<Self, T::Error> {
        struct Table;
        impl<'de> Visitor<'de> for Table {
            type Value = WallShape;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a map")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<WallShape, A::Error> {
                let (mut name, mut velocity, mut moves, mut shape) = (None, None, None, None);
                while let Some(key) = map.next_key::<String>()? {
                    match key.as_str() {
                        "name" => name = Some(map.next_value()?),
                        "velocity" => velocity = Some(map.next_value()?),
                        "moves" => moves = Some(map.next_value()?),
                        other => match SHAPE_NAMES.iter().find(|known| **known == other) {
                            Some(_) if shape.is_some() => return Err(A::Error::custom("one shape, found two in one table")),
                            Some(known) => shape = Some(map.next_value_seed(OfKind(known))?),
                            None => return Err(A::Error::unknown_variant(other, &ALL_NAMES)),
                        },
                    }
                }
                let shape =
                    shape.ok_or_else(|| A::Error::custom("a table without a shape, expected one of box, polygon, circle, tank, ..."))?;
                Ok(WallShape { name, velocity, moves, shape })
            }
        }
        deserializer.deserialize_map(Table)
    }
}

/// What may stand in the table of a wall: the shapes, then the other keys.
const ALL_NAMES: [&str; 10] = {
    let mut names = [""; 10];
    let mut i = 0;
    while i < SHAPE_NAMES.len() {
        names[i] = SHAPE_NAMES[i];
        i += 1;
    }
    let mut k = 0;
    while k < KEYS.len() {
        names[i + k] = KEYS[k].0;
        k += 1;
    }
    names
};

/// Reads what stands under the name of a shape.
struct OfKind(&'static str);

impl<'de> DeserializeSeed<'de> for OfKind {
    type Value = Shape;
    fn deserialize<T: Deserializer<'de>>(self, deserializer: T) -> Result<Shape, T::Error> {
        struct Body(&'static str);
        impl<'de> Visitor<'de> for Body {
            type Value = Shape;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a map")
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Shape, A::Error> {
                Shape::deserialize(Named { name: self.0, map })
            }
        }
        deserializer.deserialize_map(Body(self.0))
    }
}

/// A shape as the enum that serde expects: its name, then its table.
struct Named<A> {
    name: &'static str,
    map: A,
}

impl<'de, A: MapAccess<'de>> Deserializer<'de> for Named<A> {
    type Error = A::Error;
    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, A::Error> {
        visitor.visit_enum(self)
    }
    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 u8 u16 u32 u64 f32 f64 char str string bytes byte_buf option unit unit_struct newtype_struct seq tuple
        tuple_struct map struct enum identifier ignored_any
    }
}

impl<'de, A: MapAccess<'de>> EnumAccess<'de> for Named<A> {
    type Error = A::Error;
    type Variant = Self;
    fn variant_seed<V: DeserializeSeed<'de>>(self, seed: V) -> Result<(V::Value, Self), A::Error> {
        let name = serde::de::value::BorrowedStrDeserializer::<A::Error>::new(self.name);
        Ok((seed.deserialize(name)?, self))
    }
}

impl<'de, A: MapAccess<'de>> VariantAccess<'de> for Named<A> {
    type Error = A::Error;
    fn unit_variant(self) -> Result<(), A::Error> {
        Err(A::Error::custom("a shape has a table of numbers"))
    }
    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value, A::Error> {
        seed.deserialize(MapAccessDeserializer::new(self.map))
    }
    fn tuple_variant<V: Visitor<'de>>(self, _: usize, _: V) -> Result<V::Value, A::Error> {
        Err(A::Error::custom("a shape has a table of numbers"))
    }
    fn struct_variant<V: Visitor<'de>>(self, fields: &'static [&'static str], visitor: V) -> Result<V::Value, A::Error> {
        MapAccessDeserializer::new(self.map).deserialize_struct("shape", fields, visitor)
    }
}

impl JsonSchema for WallShape {
    fn schema_name() -> Cow<'static, str> {
        "WallShape".into()
    }

    /// Any shape, with the other keys beside it.
    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let mut schema = Shape::json_schema(generator);
        if let Some(variants) = schema.get_mut("oneOf").and_then(|variants| variants.as_array_mut()) {
            for variant in variants {
                for (key, kind, unit, rule, text) in KEYS {
                    let types = match kind {
                        "boolean" => serde_json::json!({"type": "boolean"}),
                        "list of formulas" => serde_json::json!({"type": "array", "items": {"type": ["string", "number"]}, "kind": kind}),
                        _ => serde_json::json!({"type": "string"}),
                    };
                    variant["properties"][key] = types;
                    for (name, value) in [("description", text), ("unit", unit), ("rule", rule)] {
                        if !value.is_empty() {
                            variant["properties"][key][name] = value.into();
                        }
                    }
                }
            }
        }
        schema
    }
}

/// The schemas of the keys beside the shape, for the reference.
pub(super) fn key_rows() -> impl Iterator<Item = (&'static str, &'static str, &'static str, &'static str, &'static str)> {
    KEYS.into_iter()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_is_read_and_written_back() {
        let text = r#"name = "lid"
velocity = ["sin(t)", 0]
moves = false
box = { min = [0.0, 1.0], max = [1.0, 1.1] }"#;
        let wall: WallShape = toml::from_str(text).unwrap();
        assert_eq!((wall.name.as_deref(), wall.moves), (Some("lid"), Some(false)));
        assert_eq!(wall.velocity, Some(vec![Written("sin(t)".into()), Written("0".into())]));
        assert_eq!(toml::from_str::<WallShape>(&toml::to_string(&wall).unwrap()).unwrap(), wall);
        for (from, to) in
            [("box =", "boks ="), ("max", "mux"), ("name =", "nam ="), ("moves = false", "circle = { center = [0.0, 0.0], radius = 1.0 }")]
        {
            assert!(toml::from_str::<WallShape>(&text.replace(from, to)).is_err(), "{from} -> {to}");
        }
    }
}
