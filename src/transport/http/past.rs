//! The order of every swarm over the last minutes, so that whoever opens the page sees where each
//! comes from.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};

/// Orders kept of a swarm: one a second.
const KEPT: usize = 120;

/// The last orders of every swarm.
#[derive(Default)]
pub struct Past(Mutex<BTreeMap<String, VecDeque<f64>>>);

#[derive(Deserialize)]
struct Document<'a> {
    #[serde(borrow)]
    result: Swarms<'a>,
}

#[derive(Deserialize)]
struct Swarms<'a> {
    #[serde(borrow)]
    swarms: Vec<Row<'a>>,
}

#[derive(Deserialize)]
struct Row<'a> {
    swarm: &'a str,
    order: f64,
}

#[derive(Serialize)]
struct Told<'a> {
    orders: &'a BTreeMap<String, VecDeque<f64>>,
}

impl Past {
    /// Keeps what the list of swarms says, and forgets those that are not in it.
    pub fn keep(&self, list: &[u8]) {
        let Ok(document) = serde_json::from_slice::<Document<'_>>(list) else {
            return;
        };
        let mut past = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let mut before = std::mem::take(&mut *past);
        for row in document.result.swarms {
            let mut orders = before.remove(row.swarm).unwrap_or_default();
            if orders.len() == KEPT {
                orders.pop_front();
            }
            // As fine as a line of a few pixels shows.
            orders.push_back((row.order * 1000.0).round() / 1000.0);
            past.insert(row.swarm.to_owned(), orders);
        }
    }

    /// What a tab is told, JSON.
    pub fn told(&self) -> String {
        let past = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        serde_json::to_string(&Told { orders: &past }).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_orders_of_those_that_are_there_are_told() {
        let past = Past::default();
        let list = |rows: &str| format!(r#"{{"node":"a","result":{{"swarms":[{rows}]}}}}"#);
        for step in 0..KEPT + 5 {
            let order = step as f64 / 1e3;
            let rows = format!(r#"{{"swarm":"a","order":{order}}},{{"swarm":"b","order":1}}"#);
            past.keep(list(&rows).as_bytes());
        }
        past.keep(list(r#"{"swarm":"a","order":0.12345}"#).as_bytes());
        past.keep(b"no list");
        let told = past.told();
        assert!(
            told.starts_with(r#"{"orders":{"a":[0.006,0.007,"#),
            "{told}"
        );
        assert!(told.ends_with(r#"0.124,0.123]}}"#), "{told}");
    }
}
