//! Tests of the statistics of conditions.

use super::*;
use crate::samples::{sample, with};

#[test]
fn quantiles_of_student_t_are_those_of_tables() {
    // scipy.stats.t.ppf(0.975, freedom)
    for (freedom, expected) in [
        (1, 12.706_204_736_174_694),
        (2, 4.302_652_729_749_462),
        (3, 3.182_446_305_283_708),
        (4, 2.776_445_105_197_793),
        (9, 2.262_157_162_798_205),
        (30, 2.042_272_456_301_238),
        (200, 1.971_896_224_154_653),
        (201, 1.971_836_5),
        (1000, 1.962_339_080_826_409),
    ] {
        let quantile = student_t(freedom);
        assert!((quantile - expected).abs() < 1e-6, "{freedom}: {quantile}");
    }
}

#[test]
fn runs_that_differ_in_any_parameter_are_of_two_conditions() {
    type Change = (&'static str, fn(&mut ResultRow));
    let changes: [Change; 8] = [
        ("n", |run| run.n = 20),
        ("pi1", |run| run.pi1 = 2.0),
        ("pi2", |run| run.pi2 = 2.0),
        ("pi3", |run| run.pi3 = 2.0),
        ("pi4", |run| run.pi4 = 2.0),
        ("informed", |run| run.informed = 2),
        ("contacts", |run| run.contacts = "closest".to_owned()),
        ("dt", |run| run.dt = 0.01),
    ];
    for (name, change) in changes {
        let one = ResultRow {
            informed: 1,
            ..sample()
        };
        let mut other = one.clone();
        change(&mut other);
        let runs = [one.clone(), other.clone(), one, other];
        let counts: Vec<_> = summarise(&runs).iter().map(|it| it.runs).collect();
        assert_eq!(counts, [2, 2], "{name}");
    }
}

#[test]
fn runs_are_grouped_by_all_but_their_seed() {
    let changed = |change: fn(&mut ResultRow)| {
        let mut run = sample();
        change(&mut run);
        run
    };
    let runs = [
        changed(|run| run.contacts = "closest".to_owned()),
        changed(|run| run.n = 20),
        changed(|run| run.seed = 7),
        // Without informed individuals their weight makes no difference.
        changed(|run| run.pi2 = 0.5),
        changed(|run| run.dt = 0.01),
    ];
    let summaries = summarise(&runs);
    let found: Vec<_> = summaries
        .iter()
        .map(|summary| {
            let condition = &summary.condition;
            (
                &*condition.contacts,
                condition.dt,
                condition.n,
                summary.runs,
            )
        })
        .collect();
    assert_eq!(
        found,
        [
            ("endpoints", 0.01, 10, 1),
            ("endpoints", 0.02, 10, 2),
            ("endpoints", 0.02, 20, 1),
            ("closest", 0.02, 10, 1),
        ]
    );
    assert!(summarise(&[]).is_empty());
}

#[test]
fn variables_and_other_axes_make_conditions_and_measures_are_averaged() {
    let run = |name: &str, share: f64, stopped_at: Option<f64>, milling: f64| ResultRow {
        run: name.to_owned(),
        extra: [
            ("share", Some(share)),
            ("stopped_at", stopped_at),
            ("milling", Some(milling)),
        ]
        .map(|(name, value)| ExtraValue {
            name: name.to_owned(),
            value,
        })
        .into(),
        ..sample()
    };
    let summaries = summarise(&[
        run("pi1=4 noise=0.1 share=0.2 #0", 0.2, Some(3.0), 0.5),
        run("pi1=4 noise=0.1 share=0.05 #0", 0.05, None, 0.0),
        run("pi1=4 noise=0.1 share=0.2 #1", 0.2, None, 0.25),
    ]);
    let names: Vec<&str> = summaries.iter().map(|it| &*it.condition.others).collect();
    assert_eq!(names, ["noise=0.1 share=0.05", "noise=0.1 share=0.2"]);
    let found = |index: usize| -> Vec<(&str, usize, Option<f64>)> {
        let extra = summaries[index].extra.iter();
        extra
            .map(|it| (&*it.name, it.runs, it.spread.map(|it| it.mean)))
            .collect()
    };
    assert_eq!(
        found(0),
        [("stopped_at", 0, None), ("milling", 1, Some(0.0))]
    );
    assert_eq!(
        found(1),
        [("stopped_at", 1, Some(3.0)), ("milling", 2, Some(0.375))]
    );
    assert_eq!(others("#0"), "");
}

#[test]
fn deviations_are_normalised_by_the_runs_minus_one() {
    let values = [1.0, 2.0, 3.0, 6.0];
    let found = mean_of(&values);
    assert_eq!(found.mean, 3.0);
    assert_eq!(found.deviation, Some((14.0_f64 / 3.0).sqrt()));
    assert_eq!(found.error, Some((14.0_f64 / 3.0).sqrt() / 2.0));
    assert_eq!(mean_of(&[0.5]).deviation, None);
}

#[test]
fn interval_lengths_are_time_over_intervals() {
    let found = mean_interval(&[(30.0, 3.0), (10.0, 1.0), (20.0, 4.0)]).unwrap();
    assert_eq!(found.mean, 7.5);
    // Residuals 7.5, 2.5, -10; squares sum to 162.5, over 3 · 2; 8/3 intervals a run.
    let expected = (162.5_f64 / 6.0).sqrt() / (8.0 / 3.0);
    assert!((found.error.unwrap() - expected).abs() < 1e-12);
    assert_eq!(mean_interval(&[(30.0, 3.0)]).unwrap().error, None);
    assert_eq!(mean_interval(&[(0.0, 0.0), (0.0, 0.0)]), None);
}

#[test]
fn intervals_are_shown_only_if_every_run_reached_order() {
    let reached = sample();
    let never = with(sample(), Measure::ORDERED_INTERVALS, 0);
    let never = with(never, Measure::ORDERED_TIME, 0.0);
    let both = &summarise(&[reached.clone(), never])[0];
    assert_eq!((both.build_up, both.breakdown), (None, None));

    let alone = &summarise(&[reached])[0];
    assert_eq!(alone.build_up.unwrap().mean, 25.0);
    assert_eq!(alone.breakdown.unwrap().mean, 950.0 / 3.0);
    assert_eq!(alone.v_pd, None);
    assert!(alone.n_eff.unwrap() > 5.0);
}

#[test]
fn the_runs_of_a_condition_are_together_whether_or_not_they_were_ever_informed() {
    let run = |name: &str, pi2: f64, v_pd: Option<f64>| {
        let row = ResultRow {
            run: name.to_owned(),
            pi2,
            ..sample()
        };
        with(row, Measure::V_PD, v_pd)
    };
    let found = |runs: &[ResultRow]| -> Vec<(f64, usize)> {
        let all = summarise(runs);
        all.iter().map(|it| (it.condition.pi2, it.runs)).collect()
    };
    // A condition of a protocol held in the second run alone.
    let runs = [
        run("n=10 #0", 0.5, None),
        run("n=10 #1", 0.5, Some(0.2)),
        run("n=10 #2", 0.5, None),
    ];
    assert_eq!(found(&runs), [(0.5, 3)]);
    assert_eq!(summarise(&runs)[0].v_pd, None);
    // The weight made a difference to one run, so it may have made one to all.
    let runs = [
        run("pi2=0.9 #0", 0.9, None),
        run("pi2=0.2 #0", 0.2, None),
        run("pi2=0.9 #1", 0.9, Some(0.1)),
        run("pi2=0.2 #1", 0.2, None),
    ];
    assert_eq!(found(&runs), [(0.2, 2), (0.9, 2)]);
    assert_eq!(found(&[runs[1].clone(), runs[0].clone()]), [(0.0, 2)]);
}

/// A number below `end` of a sequence that `state` determines.
fn below(state: &mut u64, end: u64) -> u64 {
    *state = state
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1_442_695_040_888_963_407);
    (*state >> 33) % end
}

#[test]
fn columns_that_only_some_runs_have_split_no_condition() {
    for seed in 0..300u64 {
        let mut state = seed;
        let mut draw = |end| below(&mut state, end);
        // One grid: every name has the same axes, and a value of its own for each.
        let mut rows = Vec::new();
        let (has_pi2, has_noise, has_share) = (draw(2) > 0, draw(2) > 0, draw(2) > 0);
        for n in [4, 20] {
            for index in 0..2u32 {
                let mut name = format!("n={n}");
                let level = f64::from(index + 1) / 4.0;
                if has_pi2 {
                    name.insert_str(0, &format!("pi2={level} "));
                }
                if has_noise {
                    name += &format!(" noise={level}");
                }
                if has_share {
                    name += &format!(" share={level}");
                }
                let (count, informed) = (1 + draw(4), draw(3) * draw(2));
                for replicate in 0..count {
                    let value = |name: &str, value| ExtraValue {
                        name: name.to_owned(),
                        value,
                    };
                    let mut extra = Vec::new();
                    if has_share {
                        extra.push(value("share", Some(level)));
                    }
                    if draw(2) > 0 {
                        extra.push(value("stopped_at", (draw(2) > 0).then_some(3.0)));
                    }
                    if draw(2) > 0 {
                        extra.push(value("milling", (draw(2) > 0).then_some(0.5)));
                    }
                    let row = ResultRow {
                        run: format!("{name} #{replicate}"),
                        n,
                        informed,
                        pi2: if has_pi2 { level } else { 0.5 },
                        extra,
                        fault: (draw(8) == 0).then(|| "step 3".to_owned()),
                        ..sample()
                    };
                    let v_pd = (informed > 0 || draw(2) > 0).then_some(0.25);
                    rows.push(with(row, Measure::V_PD, v_pd));
                }
            }
        }
        let shift = usize::try_from(draw(5)).unwrap() % rows.len();
        rows.rotate_left(shift);
        let found = summarise(&rows);
        let of = |row: &ResultRow| row.run.split_once(" #").unwrap().0.to_owned();
        let total: usize = found.iter().map(|it| it.runs).sum();
        assert_eq!(total, rows.len(), "seed {seed}");
        // Without another axis than n, the two levels of one n are one condition, unless they differ in
        // what is informed at the start. Each other name is one, with all of its runs, unless it differs
        // in the weight alone, and nobody was ever informed.
        let mut expected: Vec<(u64, Vec<String>)> = Vec::new();
        for row in &rows {
            let same = |other: &&ResultRow| {
                let without = |it: &ResultRow| {
                    let name = of(it);
                    name.split(' ')
                        .filter(|it| !it.starts_with("pi2="))
                        .collect::<String>()
                };
                other.informed == row.informed && without(other) == without(row)
            };
            let group: Vec<&ResultRow> = rows.iter().filter(same).collect();
            let ever = group
                .iter()
                .any(|it| it.informed > 0 || it.optional_number(Measure::V_PD).is_some());
            let group = group.iter().filter(|it| !ever || of(it) == of(row));
            let mut group: Vec<String> = group.map(|it| it.run.clone()).collect();
            group.sort();
            let group = (row.informed, group);
            if !expected.contains(&group) {
                expected.push(group);
            }
        }
        let mut counts: Vec<usize> = found.iter().map(|it| it.runs).collect();
        let mut wanted: Vec<usize> = expected.iter().map(|(_, runs)| runs.len()).collect();
        counts.sort_unstable();
        wanted.sort_unstable();
        assert_eq!(counts, wanted, "seed {seed}: {expected:?}");
        for summary in &found {
            for extra in &summary.extra {
                assert!(extra.runs <= summary.runs, "seed {seed}");
            }
        }
    }
}
