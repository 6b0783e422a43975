//! Tests of the means over a value and over time.

use super::*;
use crate::ExtraValue;
use crate::samples::sample;
use crate::table::MeasureSeries;

fn row(run: &str, milling: Option<f64>) -> ResultRow {
    let name = "milling".to_owned();
    ResultRow {
        run: run.to_owned(),
        extra: vec![ExtraValue {
            name,
            value: milling,
        }],
        ..sample()
    }
}

fn rows() -> Vec<ResultRow> {
    vec![
        row("pi1=4 share=0.1 #0", Some(1.0)),
        row("pi1=4 share=0.1 #1", Some(2.0)),
        row("pi1=4 share=0.1 #2", Some(6.0)),
        row("pi1=4 share=0.05 #0", Some(5.0)),
        row("pi1=4 share=0.05 #1", None),
        row("pi1=10 share=0.1 #0", Some(-1.0)),
        row("pi1=2 share=0.1 #0", None),
    ]
}

#[test]
fn means_and_intervals_are_those_computed_by_hand() {
    let chart = over_value(&rows(), "milling", Some("share")).unwrap();
    let labels: Vec<&str> = chart.curves.iter().map(|it| it.label.as_str()).collect();
    assert_eq!(labels, ["pi1=4", "pi1=10"]);
    assert_eq!((chart.runs, chart.left_out), (7, 2));
    assert_eq!(chart.empty, ["pi1=2 share=0.1"]);
    let [low, high] = chart.curves[0].points[..] else {
        panic!("{chart:?}")
    };
    assert_eq!((low.x, low.spread.mean, low.runs), (0.05, 5.0, 1));
    assert_eq!(low.half_width(), None);
    // 1, 2 and 6: s² = (4 + 1 + 9) / 2, and t(0.975, 2) = 4.302653.
    assert_eq!((high.x, high.spread.mean, high.runs), (0.1, 3.0, 3));
    let expected = 4.302_652_73 * (7.0_f64 / 3.0).sqrt();
    assert!((high.half_width().unwrap() - expected).abs() < 1e-7);
}

#[test]
fn the_only_number_that_varies_is_the_horizontal_axis() {
    let rows = [
        row("n=3 contacts=closest #0", Some(1.0)),
        row("n=20 contacts=endpoints #0", Some(2.0)),
        row("n=10 contacts=endpoints #0", Some(3.0)),
    ];
    let chart = over_value(&rows, "milling", None).unwrap();
    assert_eq!(chart.x, "n");
    assert_eq!(chart.curves[1].label, "contacts=endpoints");
    let points: Vec<f64> = chart.curves[1].points.iter().map(|it| it.x).collect();
    assert_eq!(points, [10.0, 20.0]);
    // A column that does not vary is a chart of one point.
    let chart = over_value(&rows[..1], "v", Some("pi3")).unwrap();
    assert_eq!(chart.curves[0].points.len(), 1);
}

#[test]
fn names_that_do_not_fit_are_rejected_with_those_that_do() {
    let message = |rows: &[ResultRow], y, x| over_value(rows, y, x).unwrap_err().to_string();
    let unknown = message(&rows(), "mill", None);
    assert!(unknown.starts_with("--y mill: no such column"), "{unknown}");
    assert!(
        unknown.contains("v_pd") && unknown.contains("milling"),
        "{unknown}"
    );
    let unknown = message(&rows(), "v", Some("shar"));
    assert!(unknown.contains("use one of pi1, share, n,"), "{unknown}");
    let several = message(&rows(), "v", None);
    assert!(
        several.contains("pi1, share: choose one with --x"),
        "{several}"
    );
    let text = [row("contacts=closest #0", None), row("contacts=a #0", None)];
    assert!(message(&text, "v", None).contains("--over-time"));
    assert!(message(&text, "v", Some("contacts")).contains("no number"));
    assert!(message(&rows()[6..], "milling", Some("n")).contains("none of the 1 runs"));
    assert!(message(&[], "v", None).contains("no runs"));
}

#[test]
fn a_measured_or_constant_horizontal_axis_is_rejected() {
    let message = |x| {
        let error = over_value(&rows(), "milling", Some(x)).unwrap_err();
        error.to_string()
    };
    for measured in ["v", "milling", "time", "ordered_time", "steps"] {
        let error = message(measured);
        assert!(
            error.starts_with(&format!("--x {measured}: it is measured")),
            "{error}"
        );
        assert!(error.contains("one of pi1, share, n,"), "{error}");
    }
    let constant = message("n");
    let expected = "--x n: it is 10 in all 7 runs: choose one that varies, pi1, share";
    assert_eq!(constant, expected);
    let same = [row("n=10 #0", Some(1.0)), row("n=10 #1", Some(2.0))];
    let error = over_value(&same, "milling", Some("n"))
        .unwrap_err()
        .to_string();
    assert_eq!(error, "--x n: it is 10 in all 2 runs: no value varies");
}

#[test]
fn faulted_runs_are_removed_and_named() {
    let mut all = rows();
    for index in [1, 4] {
        all[index].fault = Some("step 3: crossed".to_owned());
    }
    let faulted = remove_faulted(&mut all).unwrap();
    assert_eq!(faulted, ["pi1=4 share=0.1 #1", "pi1=4 share=0.05 #1"]);
    assert_eq!(all.len(), 5);
    assert_eq!(remove_faulted(&mut all).unwrap(), [""; 0]);
    all.iter_mut()
        .for_each(|row| row.fault = Some(String::new()));
    let error = remove_faulted(&mut all).unwrap_err().to_string();
    assert!(error.contains("all 5 runs ended by a fault"), "{error}");
    assert!(remove_faulted(&mut Vec::new()).unwrap().is_empty());
}

fn series(run: &str, steps: &[u64], values: &[Option<f64>]) -> Series {
    Series {
        run: run.to_owned(),
        steps: steps.to_vec(),
        times: steps.iter().map(|step| *step as f64 * 0.5).collect(),
        measures: vec![MeasureSeries {
            name: "order".to_owned(),
            values: values.to_vec(),
        }],
    }
}

#[test]
fn means_over_time_leave_out_the_last_entries_of_runs_that_end_early() {
    let all = [
        series("n=3 #0", &[0, 10, 20, 25], &[1.0, 2.0, 3.0, 4.0].map(Some)),
        series("n=3 #1", &[0, 10, 13], &[Some(3.0), None, Some(100.0)]),
        series("n=5 #0", &[0, 10, 20, 25], &[None; 4]),
    ];
    let chart = over_time(&all, "order").unwrap();
    assert_eq!((chart.runs, chart.left_out, chart.ended_early), (3, 1, 1));
    let labels: Vec<&str> = chart.curves.iter().map(|it| it.label.as_str()).collect();
    assert_eq!((labels, chart.empty), (vec!["n=3"], vec!["n=5".to_owned()]));
    let points = chart.curves[0].points.iter();
    let points: Vec<_> = points.map(|it| (it.x, it.spread.mean, it.runs)).collect();
    assert_eq!(points, [(0.0, 2.0, 2), (5.0, 2.0, 1), (10.0, 3.0, 1)]);
    // Both runs of n=3 end at step 25: the last state is shown.
    let both = [
        all[0].clone(),
        series("n=3 #1", &[0, 10, 20, 25], &[Some(0.0); 4]),
    ];
    let chart = over_time(&both, "order").unwrap();
    assert_eq!(chart.curves[0].points.last().unwrap().x, 12.5);
    let unknown = over_time(&all, "ordr").unwrap_err().to_string();
    assert!(unknown.contains("use one of order"), "{unknown}");
}

#[test]
fn a_curve_is_interrupted_where_none_of_its_runs_has_a_value() {
    let gap = |points: &[Mean]| -> Vec<(f64, bool)> {
        points.iter().map(|it| (it.x, it.after_gap)).collect()
    };
    let values = [None, Some(1.0), Some(1.0), None, None, Some(2.0), Some(3.0)];
    let steps = [0, 10, 20, 30, 40, 50, 60];
    let other = [None, None, None, Some(4.0), None, None, None];
    let all = [series("n=3 #0", &steps, &values)];
    let chart = over_time(&all, "order").unwrap();
    let expected = [(5.0, false), (10.0, false), (25.0, true), (30.0, false)];
    assert_eq!(gap(&chart.curves[0].points), expected);
    // Another run has a value at step 30, but none has at 40.
    let both = [all[0].clone(), series("n=3 #1", &steps, &other)];
    let chart = over_time(&both, "order").unwrap();
    let expected = [5.0, 10.0, 15.0, 25.0, 30.0].map(|x| (x, x == 25.0));
    assert_eq!(gap(&chart.curves[0].points), expected);
    // The same over a value: no run of share=0.2 has one.
    let rows = [
        row("share=0.1 #0", Some(1.0)),
        row("share=0.2 #0", None),
        row("share=0.3 #0", Some(1.0)),
        row("share=0.3 #1", None),
        row("share=0.4 #0", Some(2.0)),
    ];
    let chart = over_value(&rows, "milling", None).unwrap();
    let expected = [(0.1, false), (0.3, true), (0.4, false)];
    assert_eq!(gap(&chart.curves[0].points), expected);
    assert_eq!(
        (chart.left_out, &chart.empty[..]),
        (2, &["share=0.2".to_owned()][..])
    );
}
