//! Rows for tests.

use jostle_proto::{Cell, ExtraValue, Measure, ResultRow};

/// A row as an experiment could produce it.
pub(crate) fn sample() -> ResultRow {
    ResultRow {
        run: "pi1=4 n=10 #0".to_owned(),
        seed: (1 << 53) - 1,
        n: 10,
        pi1: 4.0,
        pi2: 0.0,
        pi3: 1.0,
        pi4: 10.0,
        informed: 0,
        contacts: "endpoints".to_owned(),
        dt: 0.02,
        time: 1000.0,
        measures: vec![
            (Measure::V, 0.9.into()),
            (Measure::V_PD, None.into()),
            (Measure::ORDERED_INTERVALS, 3.into()),
            (Measure::ORDERED_TIME, 950.0.into()),
            (Measure::UNORDERED_INTERVALS, 2.into()),
            (Measure::UNORDERED_TIME, 50.0.into()),
            (Measure::WORST_OVERLAP, 2.6e-3.into()),
            (Measure::CROSSED_SHARE, 0.0.into()),
            (Measure::WORST_RESIDUAL, 1e-9.into()),
            (Measure::DEGRADED, 0.into()),
            (Measure::FALLBACKS, 0.into()),
        ],
        steps: 50_000,
        state_hash: "00ff".to_owned(),
        extra: Vec::new(),
        fault: None,
    }
}

/// Rows whose values are hard to store exactly.
pub(crate) fn samples() -> Vec<ResultRow> {
    let awkward = [
        0.1 + 0.2,
        f64::MIN_POSITIVE,
        5e-324,
        f64::MAX,
        1.0 / 3.0,
        -0.0,
        f64::INFINITY,
    ];
    let extra = |share: f64, stopped_at: Option<f64>| {
        let value = |name: &str, value| ExtraValue {
            name: name.to_owned(),
            value,
        };
        vec![value("share", Some(share)), value("stopped_at", stopped_at)]
    };
    let mut runs = vec![ResultRow {
        extra: extra(0.5, None),
        ..sample()
    }];
    for (index, value) in awkward.into_iter().enumerate() {
        let v_pd = (index % 2 == 0).then_some(-value);
        let row = ResultRow {
            run: format!("quoted \", {index}\nµ"),
            extra: extra(value, v_pd),
            ..sample()
        };
        runs.push(with(with(row, Measure::V, value), Measure::V_PD, v_pd));
    }
    runs
}

/// Returns `row` with another value of `measure`.
pub(crate) fn with(mut row: ResultRow, measure: Measure, value: impl Into<Cell>) -> ResultRow {
    row.set(measure, value.into());
    row
}
