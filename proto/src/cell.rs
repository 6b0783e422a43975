//! A value of a table of results, and its kind.

use schemars::Schema;
use schemars::json_schema;
use serde::de::{Deserialize, DeserializeSeed, Deserializer};

/// The kind of the values of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CellKind {
    /// Text.
    Text,
    /// A whole number, 0 or more.
    Count,
    /// A number.
    Number,
    /// A number or [`Cell::Absent`].
    OptionalNumber,
}

/// The value of one row in one column.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[serde(untagged)]
pub enum Cell {
    /// Text.
    Text(Box<str>),
    /// A whole number, 0 or more.
    Count(u64),
    /// A number.
    Number(f64),
    /// No value: `null` in JSON, an empty field in CSV.
    Absent,
}

impl From<f64> for Cell {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl From<Option<f64>> for Cell {
    fn from(number: Option<f64>) -> Self {
        number.map_or(Self::Absent, Self::Number)
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text.into())
    }
}

impl From<u64> for Cell {
    fn from(count: u64) -> Self {
        Self::Count(count)
    }
}

impl CellKind {
    /// Returns whether `cell` is a value of this kind.
    #[must_use]
    pub fn admits(self, cell: &Cell) -> bool {
        matches!(
            (self, cell),
            (Self::Text, Cell::Text(_))
                | (Self::Count, Cell::Count(_))
                | (Self::Number, Cell::Number(_))
                | (Self::OptionalNumber, Cell::Number(_) | Cell::Absent)
        )
    }

    /// Returns the schema of the values of this kind.
    pub(crate) fn schema(self) -> Schema {
        match self {
            Self::Text => json_schema!({"type": "string"}),
            Self::Count => {
                json_schema!({"type": "integer", "format": "uint64", "minimum": 0})
            }
            Self::Number => json_schema!({"type": "number", "format": "double"}),
            Self::OptionalNumber => {
                json_schema!({"type": ["number", "null"], "format": "double"})
            }
        }
    }
}

/// A [`Cell`] of another kind was expected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WrongKind;

impl TryFrom<Cell> for String {
    type Error = WrongKind;

    fn try_from(cell: Cell) -> Result<Self, WrongKind> {
        match cell {
            Cell::Text(text) => Ok(text.into()),
            _ => Err(WrongKind),
        }
    }
}

impl TryFrom<Cell> for u64 {
    type Error = WrongKind;

    fn try_from(cell: Cell) -> Result<Self, WrongKind> {
        match cell {
            Cell::Count(count) => Ok(count),
            _ => Err(WrongKind),
        }
    }
}

impl TryFrom<Cell> for f64 {
    type Error = WrongKind;

    fn try_from(cell: Cell) -> Result<Self, WrongKind> {
        match cell {
            Cell::Number(number) => Ok(number),
            _ => Err(WrongKind),
        }
    }
}

impl TryFrom<Cell> for Option<f64> {
    type Error = WrongKind;

    fn try_from(cell: Cell) -> Result<Self, WrongKind> {
        match cell {
            Cell::Absent => Ok(None),
            cell => f64::try_from(cell).map(Some),
        }
    }
}

impl<'de> DeserializeSeed<'de> for CellKind {
    type Value = Cell;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Cell, D::Error> {
        Ok(match self {
            Self::Text => Cell::Text(String::deserialize(deserializer)?.into()),
            Self::Count => Cell::Count(u64::deserialize(deserializer)?),
            Self::Number => Cell::Number(f64::deserialize(deserializer)?),
            Self::OptionalNumber => Option::<f64>::deserialize(deserializer)?.into(),
        })
    }
}
