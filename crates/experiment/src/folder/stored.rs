//! The time series in a line of the list of runs, and in files of earlier versions.

use std::fs;
use std::path::Path;

use jostle_results::table::Series;
use jostle_results::table::order::MEASURES;
use serde::{Deserialize, Deserializer, Serialize};

use super::error::{FolderError, io_error};
use crate::plan::Plan;
use crate::series::encoded_bytes;

/// The order parameter every `order_every` steps, and the drift if individuals are informed.
#[derive(Deserialize, Serialize)]
pub struct StoredOrder {
    order: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    drift: Vec<Option<f64>>,
}

impl StoredOrder {
    /// Returns the steps, and the values of each measure.
    pub fn columns(self, plan: &Plan) -> (Vec<u64>, Vec<Vec<Option<f64>>>) {
        let every = plan.order_every.unwrap_or(1);
        let count = self.order.len();
        let drift = match self.drift.is_empty() {
            true => vec![None; count],
            // The files of earlier versions have NaN.
            false => self
                .drift
                .into_iter()
                .map(|drift| drift.filter(|it| !it.is_nan()))
                .collect(),
        };
        let steps = (0..count as u64).map(|entry| entry * every);
        let order = self.order.into_iter().map(Some);
        (steps.collect(), vec![order.collect(), drift])
    }
}

impl From<Series> for StoredOrder {
    fn from(series: Series) -> Self {
        let mut measures = series.measures.into_iter().map(|measure| measure.values);
        let order = measures.next().unwrap_or_default();
        let drift = measures.next().unwrap_or_default();
        Self {
            order: order.into_iter().flatten().collect(),
            drift: match drift.iter().any(Option::is_some) {
                true => drift,
                false => Vec::new(),
            },
        }
    }
}

/// The chosen measures every `series_every` steps and at the last step, in the order of the plan.
#[derive(Deserialize, Serialize)]
pub struct StoredSeries {
    pub step: Vec<u64>,
    pub values: Vec<Vec<Option<f64>>>,
}

impl From<Series> for StoredSeries {
    fn from(series: Series) -> Self {
        let measures = series.measures.into_iter();
        Self {
            step: series.steps,
            values: measures.map(|measure| measure.values).collect(),
        }
    }
}

/// Reads a file of an earlier version: the orders and then the drifts, if it has drifts, as little-endian
/// doubles without a header.
pub fn read_raw(path: &Path, has_drift: bool) -> Result<StoredOrder, FolderError> {
    let bytes = fs::read(path).map_err(|source| io_error(path, source))?;
    let (numbers, _) = bytes.as_chunks();
    let mut order: Vec<f64> = numbers.iter().copied().map(f64::from_le_bytes).collect();
    let drift = match has_drift {
        true => order.split_off(order.len() / 2),
        false => Vec::new(),
    };
    let drift = drift.into_iter().map(Some).collect();
    Ok(StoredOrder { order, drift })
}

/// Reads the number of bytes of the order of a line, as [`encoded_bytes`] counts them, without its values.
pub fn order_bytes<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u64>, D::Error> {
    #[derive(Deserialize)]
    struct Shape {
        order: Count,
    }
    let shape = Option::<Shape>::deserialize(from)?;
    Ok(shape.map(|shape| encoded_bytes(shape.order.0, MEASURES.len() as u64)))
}

/// Reads the number of bytes of the measures of a line, as [`encoded_bytes`] counts them, without their
/// values.
pub fn series_bytes<'de, D: Deserializer<'de>>(from: D) -> Result<Option<u64>, D::Error> {
    #[derive(Deserialize)]
    struct Shape {
        step: Count,
        values: Count,
    }
    let shape = Option::<Shape>::deserialize(from)?;
    Ok(shape.map(|shape| encoded_bytes(shape.step.0, shape.values.0)))
}

/// The length of an array.
struct Count(u64);

impl<'de> Deserialize<'de> for Count {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl<'de> serde::de::Visitor<'de> for Visitor {
            type Value = Count;

            fn expecting(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                to.write_str("an array")
            }

            fn visit_seq<A: serde::de::SeqAccess<'de>>(
                self,
                mut seq: A,
            ) -> Result<Count, A::Error> {
                let mut count = 0;
                while seq.next_element::<serde::de::IgnoredAny>()?.is_some() {
                    count += 1;
                }
                Ok(Count(count))
            }
        }
        from.deserialize_seq(Visitor)
    }
}
