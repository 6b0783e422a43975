//! A row of an experiment's table of results.
//!
//! Its columns are listed once, in [`result_row!`]: the fixed ones are fields of [`ResultRow`], and
//! the others are measures, which the row holds as pairs of a [`Measure`] and its value. The JSON and
//! CBOR forms, the schema, `results.csv` and `results.parquet` are derived from [`COLUMNS`].

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::{Deserialize, Deserializer, Error, IgnoredAny, MapAccess, Visitor};
use serde::ser::{Serialize, SerializeMap as _, Serializer};
use serde_json::{Map, Value};

use crate::cell::{Cell, CellKind};
use crate::units::{LENGTH_UNIT, NO_UNIT, SPEED_UNIT, TIME_UNIT};

/// A column of the table of results.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Its name in JSON and in the header of a table.
    pub name: &'static str,
    /// The kind of its values.
    pub kind: CellKind,
    /// The unit of its values; `1` if they have none.
    pub unit: &'static str,
    /// A description of its values.
    pub description: &'static str,
    get: fn(&ResultRow) -> Cell,
}

impl Column {
    /// Returns the value of `row` in this column.
    #[must_use]
    pub fn get(&self, row: &ResultRow) -> Cell {
        (self.get)(row)
    }
}

/// A quantity that was measured in a run, as a column of the table of results.
#[derive(Clone, Copy, Debug)]
pub struct Measure(&'static Column);

impl PartialEq for Measure {
    fn eq(&self, other: &Self) -> bool {
        self.0.name == other.0.name
    }
}

impl Eq for Measure {}

impl Measure {
    /// Returns its column.
    #[must_use]
    pub fn column(self) -> &'static Column {
        self.0
    }
}

/// The member of a row in JSON and CBOR that contains its [`ExtraValue`]s, if it has any.
const EXTRA: &str = "extra";

/// The member of a row in JSON and CBOR with the reason of its fault, if it has one, and the name of
/// that column of a table.
pub const FAULT: &str = "fault";

/// The name of the column of a table with the time at which `[stop]` ended a run.
pub const STOPPED_AT: &str = "stopped_at";

/// The columns that a table has only sometimes, beside the variables of its grid and its chosen
/// measures. A new variable must not have one of these names.
pub const OCCASIONAL_COLUMNS: [&str; 2] = [STOPPED_AT, FAULT];

/// Renames the variable `fault` to `fault_`. Earlier versions accepted it, and wrote tables with two
/// columns of that name.
pub fn rename_fault(extra: &mut [ExtraValue]) {
    let Some(at) = extra.iter().position(|it| it.name == FAULT) else {
        return;
    };
    let mut name = format!("{FAULT}_");
    while extra.iter().any(|it| it.name == name) {
        name.push('_');
    }
    extra[at].name = name;
}

/// The value of a column that only some experiments have.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize, JsonSchema)]
pub struct ExtraValue {
    /// The column: a variable of the grid, `stopped_at`, or the mean of a measure such as `msd(5)`.
    pub name: String,
    /// `stopped_at` in time units, a measure in its unit; `null` if it is undefined.
    pub value: Option<f64>,
}

/// Defines [`ResultRow`], [`Measure`]'s constants and [`COLUMNS`] from one list of columns, in the
/// order of the table: fixed ones, measures, fixed ones.
macro_rules! result_row {
    (
        { $($(#[doc = $before_doc:literal])+ $before:ident: $before_type:ident in $before_unit:expr,)* }
        {
            $(
                $(#[doc = $measure_doc:literal])+
                $constant:ident = $measure:literal: $kind:ident in $measure_unit:expr,
            )*
        }
        { $($(#[doc = $after_doc:literal])+ $after:ident: $after_type:ident in $after_unit:expr,)* }
    ) => {
        /// The result of one run of an experiment: a row of `results.parquet` and `results.csv`.
        ///
        /// Lengths are in body sizes `s`, speeds in free speeds `v0`, times in `s/v0`.
        #[derive(Clone, Debug, PartialEq)]
        pub struct ResultRow {
            $($(#[doc = $before_doc])+ pub $before: $before_type,)*
            /// The measures with their values.
            pub measures: Vec<(Measure, Cell)>,
            $($(#[doc = $after_doc])+ pub $after: $after_type,)*
            /// Columns that only some experiments have: variables of the grid, `stopped_at`, and
            /// chosen measures.
            pub extra: Vec<ExtraValue>,
            /// Why the run ended early, if a fault ended it. The measures are then those of the time
            /// before the fault.
            pub fault: Option<String>,
        }

        impl Measure {
            $(
                $(#[doc = $measure_doc])+
                pub const $constant: Self = Self(&Column {
                    name: $measure,
                    kind: CellKind::$kind,
                    unit: $measure_unit,
                    description: concat!($($measure_doc),+),
                    get: |row| row.value(Self::$constant),
                });
            )*

            /// Every measure, in the order of the table.
            pub const ALL: &[Self] = &[$(Self::$constant),*];
        }

        /// The columns of the table, in its order.
        pub const COLUMNS: &[Column] = &[
            $(Column {
                name: stringify!($before),
                kind: <$before_type as Field>::KIND,
                unit: $before_unit,
                description: concat!($($before_doc),+),
                get: |row| row.$before.clone().into(),
            },)*
            $(*Measure::$constant.0,)*
            $(Column {
                name: stringify!($after),
                kind: <$after_type as Field>::KIND,
                unit: $after_unit,
                description: concat!($($after_doc),+),
                get: |row| row.$after.clone().into(),
            },)*
        ];

        impl ResultRow {
            /// Builds a row from its values in the order of [`COLUMNS`]. Returns `None` if they are
            /// too few, or one is not of its column's kind.
            #[must_use]
            pub fn from_cells(cells: impl IntoIterator<Item = Cell>) -> Option<Self> {
                let mut cells = cells.into_iter();
                $(let $before = <$before_type>::try_from(cells.next()?).ok()?;)*
                let mut measures = Vec::with_capacity(Measure::ALL.len());
                for &measure in Measure::ALL {
                    let cell = cells.next()?;
                    measures.push((measure, measure.0.kind.admits(&cell).then_some(cell)?));
                }
                $(let $after = <$after_type>::try_from(cells.next()?).ok()?;)*
                Some(Self {
                    $($before,)*
                    measures,
                    $($after,)*
                    extra: Vec::new(),
                    fault: None,
                })
            }
        }
    };
}

result_row! {
    {
        /// The run's name within its experiment: the varied parameters, then the replicate. The
        /// seed is derived from the name.
        run: String in NO_UNIT,
        /// The seed of all random draws.
        seed: u64 in NO_UNIT,
        /// Number of individuals.
        n: u64 in NO_UNIT,
        /// Length over width of a body.
        pi1: f64 in NO_UNIT,
        /// Weight of the informed individuals' own preference.
        pi2: f64 in NO_UNIT,
        /// Body size over turning radius.
        pi3: f64 in NO_UNIT,
        /// Translational over rotational drag.
        pi4: f64 in NO_UNIT,
        /// Number of informed individuals.
        informed: u64 in NO_UNIT,
        /// The contact rule: `endpoints`, `closest` or `clamped`.
        contacts: String in NO_UNIT,
        /// The time step.
        dt: f64 in TIME_UNIT,
        /// Duration of the run; less than that of the experiment if the run faulted.
        time: f64 in TIME_UNIT,
    }
    {
        /// Time mean of the centroid's speed, eq. (8).
        V = "v": Number in SPEED_UNIT,
        /// Mean drift along the informed individuals' direction; `null` without informed
        /// individuals.
        V_PD = "v_pd": OptionalNumber in SPEED_UNIT,
        /// Number of intervals with an order of at least 2/3, including those that the run's ends
        /// cut.
        ORDERED_INTERVALS = "ordered_intervals": Count in NO_UNIT,
        /// Total time of the ordered intervals.
        ORDERED_TIME = "ordered_time": Number in TIME_UNIT,
        /// Number of intervals with an order below 2/3, including those that the run's ends cut.
        UNORDERED_INTERVALS = "unordered_intervals": Count in NO_UNIT,
        /// Total time of the unordered intervals.
        UNORDERED_TIME = "unordered_time": Number in TIME_UNIT,
        /// The deepest overlap of any two bodies, 0 or more.
        WORST_OVERLAP = "worst_overlap": Number in LENGTH_UNIT,
        /// The share of time in which any two axes crossed.
        CROSSED_SHARE = "crossed_share": Number in NO_UNIT,
        /// The largest residual of any step.
        WORST_RESIDUAL = "worst_residual": Number in LENGTH_UNIT,
        /// Number of degraded steps: less accurate than the target, but acceptable.
        DEGRADED = "degraded": Count in NO_UNIT,
        /// Number of steps that the fallback solved because the exact solver missed its target.
        FALLBACKS = "fallbacks": Count in NO_UNIT,
    }
    {
        /// Number of steps.
        steps: u64 in NO_UNIT,
        /// The hash of the last state, BLAKE3 in hexadecimal.
        state_hash: String in NO_UNIT,
    }
}

impl ResultRow {
    /// Returns the values of the row in the order of [`COLUMNS`].
    pub fn cells(&self) -> impl ExactSizeIterator<Item = Cell> {
        COLUMNS.iter().map(|column| column.get(self))
    }

    /// Returns the value of `measure`; [`Cell::Absent`] if the row lacks it.
    #[must_use]
    pub fn value(&self, measure: Measure) -> Cell {
        let mut pairs = self.measures.iter();
        pairs
            .find(|(of, _)| *of == measure)
            .map_or(Cell::Absent, |(_, value)| value.clone())
    }

    /// Returns the value of a column that only some experiments have; `None` if it is undefined or the
    /// row lacks the column.
    #[must_use]
    pub fn extra(&self, name: &str) -> Option<f64> {
        let mut values = self.extra.iter();
        values.find(|it| it.name == name).and_then(|it| it.value)
    }

    /// Returns the value of `measure` as a number; `None` if it is absent.
    #[must_use]
    pub fn optional_number(&self, measure: Measure) -> Option<f64> {
        match self.value(measure) {
            Cell::Count(count) => Some(count as f64),
            Cell::Number(number) => Some(number),
            Cell::Text(_) | Cell::Absent => None,
        }
    }

    /// Returns the value of `measure` as a number; NaN if it is absent.
    #[must_use]
    pub fn number(&self, measure: Measure) -> f64 {
        self.optional_number(measure).unwrap_or(f64::NAN)
    }

    /// Sets the value of `measure`.
    pub fn set(&mut self, measure: Measure, value: Cell) {
        match self.measures.iter_mut().find(|(of, _)| *of == measure) {
            Some(pair) => pair.1 = value,
            None => self.measures.push((measure, value)),
        }
    }
}

/// The type of a fixed column.
trait Field: Clone + Into<Cell> + TryFrom<Cell> {
    const KIND: CellKind;
}

impl Field for String {
    const KIND: CellKind = CellKind::Text;
}

impl Field for u64 {
    const KIND: CellKind = CellKind::Count;
}

impl Field for f64 {
    const KIND: CellKind = CellKind::Number;
}

impl Serialize for ResultRow {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let optional = usize::from(!self.extra.is_empty()) + usize::from(self.fault.is_some());
        let mut map = serializer.serialize_map(Some(COLUMNS.len() + optional))?;
        for (column, cell) in COLUMNS.iter().zip(self.cells()) {
            map.serialize_entry(column.name, &cell)?;
        }
        if !self.extra.is_empty() {
            map.serialize_entry(EXTRA, &self.extra)?;
        }
        if let Some(fault) = &self.fault {
            map.serialize_entry(FAULT, fault)?;
        }
        map.end()
    }
}

impl<'de> Deserialize<'de> for ResultRow {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(RowVisitor)
    }
}

struct RowVisitor;

impl<'de> Visitor<'de> for RowVisitor {
    type Value = ResultRow;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("a row of results")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<ResultRow, A::Error> {
        let mut cells = vec![None; COLUMNS.len()];
        let mut extra: Option<Vec<ExtraValue>> = None;
        let mut fault: Option<Option<String>> = None;
        while let Some(name) = map.next_key::<String>()? {
            match COLUMNS.iter().position(|column| column.name == name) {
                Some(at) if cells[at].is_some() => {
                    return Err(Error::duplicate_field(COLUMNS[at].name));
                }
                Some(at) => cells[at] = Some(map.next_value_seed(COLUMNS[at].kind)?),
                None if name == EXTRA && extra.is_some() => {
                    return Err(Error::duplicate_field(EXTRA));
                }
                None if name == EXTRA => extra = Some(map.next_value()?),
                None if name == FAULT && fault.is_some() => {
                    return Err(Error::duplicate_field(FAULT));
                }
                None if name == FAULT => fault = Some(map.next_value()?),
                None => {
                    map.next_value::<IgnoredAny>()?;
                }
            }
        }
        for (cell, column) in cells.iter_mut().zip(COLUMNS) {
            if cell.is_none() {
                if column.kind != CellKind::OptionalNumber {
                    return Err(Error::missing_field(column.name));
                }
                *cell = Some(Cell::Absent);
            }
        }
        let row = ResultRow::from_cells(cells.into_iter().flatten())
            .ok_or_else(|| Error::custom("a value is not of its column's kind"))?;
        let (mut extra, fault) = (extra.unwrap_or_default(), fault.flatten());
        rename_fault(&mut extra);
        Ok(ResultRow {
            extra,
            fault,
            ..row
        })
    }
}

impl JsonSchema for ResultRow {
    fn schema_name() -> Cow<'static, str> {
        "ResultRow".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let mut properties: Map<String, Value> = COLUMNS
            .iter()
            .map(|column| {
                let mut schema = column.kind.schema();
                schema.insert("description".to_owned(), column.description.trim().into());
                (column.name.to_owned(), schema.into())
            })
            .collect();
        let mut extra = generator.subschema_for::<Vec<ExtraValue>>();
        let description = "Columns that only some experiments have, in their order: variables of the \
                           grid, `stopped_at`, and means of chosen measures.";
        extra.insert("description".to_owned(), description.into());
        properties.insert(EXTRA.to_owned(), extra.into());
        let description = "Why the run ended early, if a fault ended it; left out otherwise. The \
                           other values are then those of the time before the fault.";
        let fault = json_schema!({"description": description, "type": ["string", "null"]});
        properties.insert(FAULT.to_owned(), fault.into());
        let required: Vec<&str> = COLUMNS.iter().map(|column| column.name).collect();
        json_schema!({
            "description": "The result of one run of an experiment: a row of the table of results.",
            "type": "object",
            "properties": properties,
            "required": required,
        })
    }
}

/// Returns the unit of a column of every table, or of `stopped_at`; `None` if `name` is another.
#[must_use]
pub fn unit_of_column(name: &str) -> Option<&'static str> {
    let mut columns = COLUMNS.iter();
    match columns.find(|column| column.name == name) {
        Some(column) => Some(column.unit),
        None => (name == STOPPED_AT).then_some(TIME_UNIT),
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// Rows that version bf41dde wrote to `runs.jsonl`, without and with informed individuals.
    const STORED: [&str; 2] = [
        r#"{"run":"pi1=1 n=8 informed=0 #0","seed":5606957141870509,"n":8,"pi1":1.0,"pi2":0.5,"pi3":1.0,"pi4":10.0,"informed":0,"contacts":"endpoints","dt":0.02,"time":20.0,"v":0.4815954295909385,"v_pd":null,"ordered_intervals":1,"ordered_time":3.3000000000000003,"unordered_intervals":2,"unordered_time":16.7,"worst_overlap":0.0,"crossed_share":0.0,"worst_residual":1.2776361565935979e-10,"degraded":0,"fallbacks":0,"steps":1000,"state_hash":"e33db8c30b7dd010aa00374031ec49269b961651d119df9b2816a7cc75cd15ee"}"#,
        r#"{"run":"pi1=1 n=8 informed=1 #0","seed":5062650083471689,"n":8,"pi1":1.0,"pi2":0.5,"pi3":1.0,"pi4":10.0,"informed":1,"contacts":"endpoints","dt":0.02,"time":20.0,"v":0.2646689440034305,"v_pd":-0.001670503767661141,"ordered_intervals":0,"ordered_time":0.0,"unordered_intervals":1,"unordered_time":20.0,"worst_overlap":0.0,"crossed_share":0.0,"worst_residual":3.386894150553266e-11,"degraded":0,"fallbacks":0,"steps":1000,"state_hash":"bbd7ac92ac1b7cb0e0e10ec6ca4db6c7569094cf5e64d88e1ace07e92b4a0e78"}"#,
    ];

    fn rows() -> [ResultRow; 2] {
        STORED.map(|text| serde_json::from_str(text).unwrap())
    }

    #[test]
    fn stored_rows_are_read_and_written_to_the_byte() {
        for (text, row) in STORED.into_iter().zip(rows()) {
            assert_eq!(serde_json::to_string(&row).unwrap(), text);
        }
        let [uninformed, informed] = rows();
        assert_eq!((informed.n, informed.pi2, informed.steps), (8, 0.5, 1000));
        assert_eq!(informed.value(Measure::V), Cell::Number(0.2646689440034305));
        assert_eq!(informed.value(Measure::UNORDERED_INTERVALS), Cell::Count(1));
        assert_eq!(
            informed.optional_number(Measure::V_PD),
            Some(-0.001670503767661141)
        );
        assert_eq!(uninformed.optional_number(Measure::V_PD), None);
        assert!(uninformed.number(Measure::V_PD).is_nan());
    }

    #[test]
    fn in_cbor_a_row_is_a_map_of_known_length() {
        for row in rows() {
            let mut cbor = Vec::new();
            ciborium::into_writer(&row, &mut cbor).unwrap();
            // Major type 5, 24 pairs.
            assert_eq!(cbor[..2], [0xb8, 24]);
            assert_eq!(ciborium::from_reader::<ResultRow, _>(&*cbor).unwrap(), row);
        }
    }

    #[test]
    fn members_in_any_order_and_unknown_ones_are_read() {
        let mut members: Vec<(String, Value)> =
            serde_json::from_str::<Map<String, Value>>(STORED[1])
                .unwrap()
                .into_iter()
                .collect();
        members.push(("milling".to_owned(), serde_json::json!([1, {"a": 2}])));
        members.reverse();
        let text: Vec<String> = members
            .iter()
            .map(|(name, value)| format!("\"{name}\":{value}"))
            .collect();
        let read: ResultRow = serde_json::from_str(&format!("{{{}}}", text.join(","))).unwrap();
        assert_eq!(read, rows()[1]);
    }

    #[test]
    fn extra_values_are_numbers_or_null_and_keep_their_order() {
        let [_, mut row] = rows();
        let value = |name: &str, value: Option<f64>| ExtraValue {
            name: name.to_owned(),
            value,
        };
        row.extra = vec![
            value("share", Some(0.1)),
            value("stopped_at", None),
            value("clusters.largest", Some(3.0)),
        ];
        let text = serde_json::to_string(&row).unwrap();
        let end = r#","extra":[{"name":"share","value":0.1},{"name":"stopped_at","value":null},{"name":"clusters.largest","value":3.0}]}"#;
        assert!(text.ends_with(end), "{text}");
        assert_eq!(serde_json::from_str::<ResultRow>(&text).unwrap(), row);
        let mut cbor = Vec::new();
        ciborium::into_writer(&row, &mut cbor).unwrap();
        assert_eq!(cbor[..2], [0xb8, 25]);
        assert_eq!(ciborium::from_reader::<ResultRow, _>(&*cbor).unwrap(), row);
        let whole = text.replace("3.0}", "3}");
        assert_eq!(serde_json::from_str::<ResultRow>(&whole).unwrap(), row);
        assert_eq!(
            (row.extra("share"), row.extra("stopped_at")),
            (Some(0.1), None)
        );
        assert_eq!(row.extra("n"), None);
        let twice = text.replace("\"extra\":[", "\"extra\":[],\"extra\":[");
        for wrong in [text.replace("0.1", "\"x\""), twice] {
            assert!(
                serde_json::from_str::<ResultRow>(&wrong).is_err(),
                "{wrong}"
            );
        }
    }

    #[test]
    fn the_reason_of_a_fault_is_a_member_of_faulted_runs_only() {
        let [_, mut row] = rows();
        assert_eq!(row.fault, None, "as an earlier version wrote it");
        row.fault = Some("step 7: the axes of 1 and 2 cross".to_owned());
        let text = serde_json::to_string(&row).unwrap();
        let end = r#","fault":"step 7: the axes of 1 and 2 cross"}"#;
        assert!(text.ends_with(end), "{text}");
        assert_eq!(serde_json::from_str::<ResultRow>(&text).unwrap(), row);
        let mut cbor = Vec::new();
        ciborium::into_writer(&row, &mut cbor).unwrap();
        assert_eq!(cbor[..2], [0xb8, 25]);
        assert_eq!(ciborium::from_reader::<ResultRow, _>(&*cbor).unwrap(), row);
        let null = text.replace(end, r#","fault":null}"#);
        assert_eq!(serde_json::from_str::<ResultRow>(&null).unwrap(), rows()[1]);
        for wrong in [r#","fault":3}"#, r#","fault":"a","fault":"b"}"#] {
            let wrong = text.replace(end, wrong);
            assert!(serde_json::from_str::<ResultRow>(&wrong).is_err());
        }
    }

    #[test]
    fn a_missing_optional_number_is_absent() {
        let text = STORED[1].replace("\"v_pd\":", "\"w\":");
        let read: ResultRow = serde_json::from_str(&text).unwrap();
        let [_, mut expected] = rows();
        expected.set(Measure::V_PD, Cell::Absent);
        assert_eq!(read, expected);
    }

    #[test]
    fn a_missing_doubled_or_mistyped_member_is_named() {
        let error = |from: &str, to: &str| {
            let text = STORED[1].replace(from, to);
            assert_ne!(text, STORED[1]);
            serde_json::from_str::<ResultRow>(&text)
                .unwrap_err()
                .to_string()
        };
        let missing = error("\"v\":", "\"w\":");
        assert!(missing.contains("missing field `v`"), "{missing}");
        let doubled = error("\"n\":8", "\"n\":8,\"n\":8");
        assert!(doubled.contains("duplicate field `n`"), "{doubled}");
        for (from, to) in [
            ("\"n\":8", "\"n\":8.5"),
            ("\"n\":8", "\"n\":-8"),
            ("\"contacts\":\"endpoints\"", "\"contacts\":1"),
            ("\"dt\":0.02", "\"dt\":null"),
            ("\"v\":0", "\"v\":null,\"x\":0"),
            ("\"v_pd\":-0", "\"v_pd\":\"a\",\"x\":0"),
        ] {
            let mistyped = error(from, to);
            assert!(mistyped.contains("invalid"), "{to}: {mistyped}");
        }
    }

    #[test]
    fn a_row_from_cells_of_other_kinds_or_too_few_is_none() {
        let [row, _] = rows();
        let cells: Vec<Cell> = row.cells().collect();
        assert_eq!(ResultRow::from_cells(cells.clone()), Some(row));
        assert_eq!(ResultRow::from_cells(cells[1..].to_vec()), None);
        for at in 0..cells.len() {
            assert_eq!(ResultRow::from_cells(cells[..at].to_vec()), None);
            let mut other = cells.clone();
            other[at] = match COLUMNS[at].kind {
                CellKind::Text => Cell::Count(1),
                CellKind::Count => Cell::Number(1.0),
                CellKind::Number => Cell::Absent,
                CellKind::OptionalNumber => Cell::Count(1),
            };
            assert_eq!(ResultRow::from_cells(other), None, "{}", COLUMNS[at].name);
        }
    }

    #[test]
    fn a_value_that_is_set_replaces_the_earlier_one() {
        let [mut row, _] = rows();
        let count = row.measures.len();
        row.set(Measure::V, 0.25.into());
        row.set(Measure::V_PD, Some(0.5).into());
        assert_eq!(
            (row.number(Measure::V), row.number(Measure::V_PD)),
            (0.25, 0.5)
        );
        assert_eq!(row.measures.len(), count);
    }
}
