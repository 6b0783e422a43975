//! The paper's figures of random tables, read back from their pictures.

use jostle_results::disorder::v_ind;
use jostle_results::{Measure, ResultRow};

use crate::chart::readback::Numbers;
use crate::reading::{Line, PIXEL, Panel, Picture, styles};
use crate::tests::{sample, with};
use crate::{Kind, draw};

/// The runs of one point of a figure.
struct Point {
    pi1: f64,
    n: u64,
    informed: u64,
    /// The panel.
    noise: f64,
    rows: Vec<ResultRow>,
}

fn points(numbers: &mut Numbers, has_informed: bool) -> Vec<Point> {
    let sizes: &[u64] = match numbers.below(3) {
        0 => &[10],
        1 => &[2, 5, 40],
        _ => &[3, 10, 30, 100, 2000],
    };
    let elongations: &[f64] = match numbers.below(3) {
        0 => &[4.0],
        1 => &[1.0, 4.0, 8.0],
        _ => &[1.0, 1.5, 40.0],
    };
    let noises: &[f64] = match numbers.below(2) {
        0 => &[0.0],
        _ => &[0.0, 0.5],
    };
    let mut all = Vec::new();
    for &noise in noises {
        for &pi1 in elongations {
            for &n in sizes {
                if numbers.below(7) == 0 && sizes.len() > 1 {
                    continue;
                }
                let informed = if has_informed { 1 + n / 4 } else { 0 };
                let never = numbers.below(4) == 0;
                let mut rows = Vec::new();
                for replicate in 0..1 + numbers.below(4) {
                    let row = ResultRow {
                        run: format!("pi1={pi1} n={n} noise={noise} #{replicate}"),
                        pi1,
                        n,
                        informed,
                        ..sample()
                    };
                    let row = with(row, Measure::V, 0.02 + 0.98 * numbers.share());
                    let drift = has_informed.then(|| 2.0 * numbers.share() - 1.0);
                    let row = with(row, Measure::V_PD, drift);
                    let ordered = if never && replicate == 0 {
                        0
                    } else {
                        1 + numbers.below(30)
                    };
                    let row = with(row, Measure::ORDERED_INTERVALS, ordered);
                    let time = if ordered == 0 {
                        0.0
                    } else {
                        1.0 + 900.0 * numbers.share()
                    };
                    let row = with(row, Measure::ORDERED_TIME, time);
                    let row = with(row, Measure::UNORDERED_INTERVALS, 1 + numbers.below(30));
                    let row = with(row, Measure::UNORDERED_TIME, 1.0 + 90.0 * numbers.share());
                    rows.push(row);
                }
                all.push(Point {
                    pi1,
                    n,
                    informed,
                    noise,
                    rows,
                });
            }
        }
    }
    all
}

impl Point {
    fn numbers(&self, measure: Measure) -> Vec<f64> {
        self.rows
            .iter()
            .map(|row| row.optional_number(measure).unwrap())
            .collect()
    }

    /// The mean of a measure and the standard deviation of a run.
    fn spread(&self, measure: Measure) -> (f64, Option<f64>) {
        let values = self.numbers(measure);
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let squares: f64 = values.iter().map(|it| (it - mean).powi(2)).sum();
        (
            mean,
            (count > 1.0).then(|| (squares / (count - 1.0)).sqrt()),
        )
    }

    /// The total time over the number of intervals, if every run reached order.
    fn interval(&self, time: Measure, intervals: Measure) -> Option<f64> {
        let counts = |measure| -> f64 {
            let values = self.rows.iter().map(|row| row.number(measure));
            values.sum()
        };
        let reached = self
            .rows
            .iter()
            .all(|row| row.number(Measure::ORDERED_INTERVALS) > 0.0);
        reached.then(|| counts(time) / counts(intervals))
    }

    /// The standard error of a ratio of sums over N runs:
    /// `sqrt(N / (N - 1) * sum((time - ratio * intervals)^2)) / sum(intervals)`.
    fn interval_error(&self, time: Measure, intervals: Measure) -> Option<f64> {
        let ratio = self.interval(time, intervals)?;
        let runs = self.rows.len() as f64;
        let numbers = self
            .rows
            .iter()
            .map(|it| (it.number(time), it.number(intervals)));
        let squares: f64 = numbers
            .map(|(time, count)| (time - ratio * count).powi(2))
            .sum();
        let total: f64 = self.rows.iter().map(|it| it.number(intervals)).sum();
        (runs > 1.0).then(|| (runs / (runs - 1.0) * squares).sqrt() / total)
    }
}

/// An error bar: its length up and down, and the place of its mark.
struct Bar {
    value: f64,
    half: f64,
    at: (f64, f64),
}

impl Bar {
    fn assert_drawn(&self, picture: &Picture, panel: &Panel, colour: &str, what: &str) {
        let (left, up) = self.at;
        let (low, high) = (self.value - self.half, self.value + self.half);
        let is_there = |line: &&Line| {
            let [bottom, top] = line.points[..] else {
                return false;
            };
            let ends_at = |at: f64, value: f64| {
                let expected = panel.y.position(value).map(|it| it.min(panel.bottom));
                // Cut at the end of the axis; with one tick no other place is known.
                expected.is_none_or(|it| (at - it).abs() <= panel.y.tolerance(it))
            };
            line.colour == *colour
                && line.width == 1.0
                && bottom.0 == left
                && top.0 == left
                && top.1 <= up + PIXEL
                && bottom.1 >= up - PIXEL
                && ends_at(top.1, high)
                && (panel.y.logarithmic
                    && low <= 0.0
                    && (bottom.1 - panel.bottom).abs() < 2.0 * PIXEL
                    || ends_at(bottom.1, low))
        };
        assert!(
            picture.lines.iter().any(|it| is_there(&it)),
            "{what}: no bar from {low} to {high} at {left}, {up}: {panel:?}, {:?}",
            picture.lines
        );
    }
}

/// The panels with their noise, in the order of reading.
fn panels<'a>(picture: &Picture, all: &'a [Point]) -> Vec<(Panel, Vec<&'a Point>)> {
    let mut noises: Vec<f64> = all.iter().map(|it| it.noise).collect();
    noises.dedup();
    let panels = picture.panels();
    assert_eq!(panels.len(), noises.len());
    let titled = |panel: &Panel, noise: f64| {
        let end = format!(", noise = {noise}");
        picture.texts.iter().any(|text| {
            text.text.ends_with(&end)
                && text.at.1 < panel.top
                && (panel.left..panel.right).contains(&text.at.0)
        })
    };
    let of = |(panel, noise): (Panel, f64)| {
        assert!(titled(&panel, noise), "{noise}: {:?}", picture.texts);
        let points = all.iter().filter(|it| it.noise == noise).collect();
        (panel, points)
    };
    panels.into_iter().zip(noises).map(of).collect()
}

/// The places of the marks of a colour in a panel.
fn marks(picture: &Picture, panel: &Panel, colour: &str, is_filled: bool) -> Vec<(f64, f64)> {
    let within = |at: (f64, f64)| {
        (panel.left - 20.0..panel.right + 5.0).contains(&at.0)
            && (panel.top - PIXEL..=panel.bottom + PIXEL).contains(&at.1)
    };
    let all = picture
        .circles
        .iter()
        .filter(|it| it.outline == colour && (it.fill == colour) == is_filled && within(it.at));
    all.map(|it| it.at).collect()
}

#[test]
fn the_marks_of_random_figures_over_n_are_at_the_values_of_their_ticks() {
    let mut bars = [0, 0];
    for seed in 0..200u64 {
        let mut numbers = Numbers(seed);
        let all = points(&mut numbers, false);
        let rows: Vec<ResultRow> = all.iter().flat_map(|it| it.rows.clone()).collect();
        for kind in [Kind::Order, Kind::Intervals, Kind::Clusters] {
            let what = format!("seed {seed}, {kind:?}");
            let value = |point: &Point, is_filled: bool| match (kind, is_filled) {
                (Kind::Order, true) => Some(point.spread(Measure::V).0),
                (Kind::Intervals, true) => {
                    point.interval(Measure::UNORDERED_TIME, Measure::UNORDERED_INTERVALS)
                }
                (Kind::Intervals, false) => {
                    point.interval(Measure::ORDERED_TIME, Measure::ORDERED_INTERVALS)
                }
                (Kind::Clusters, true) => {
                    let mean = point.spread(Measure::V).0;
                    (mean >= v_ind(point.n)).then_some(mean)
                }
                _ => None,
            };
            let Ok(svg) = draw(kind, &rows) else {
                assert!(all.iter().all(|it| value(it, true).is_none()), "{what}");
                continue;
            };
            let picture = Picture::read(&svg);
            let styles = styles(&picture);
            for (mut panel, points) in panels(&picture, &all) {
                // Both axes of these figures are logarithmic.
                panel.x.logarithmic = true;
                panel.y.logarithmic = true;
                panel.x.check();
                panel.y.check();
                let mut elongations: Vec<f64> = points.iter().map(|it| it.pi1).collect();
                elongations.dedup();
                for pi1 in elongations {
                    let these: Vec<_> = points.iter().filter(|it| it.pi1 == pi1).collect();
                    for is_filled in [true, false] {
                        let mut expected: Vec<(u64, f64)> = these
                            .iter()
                            .filter_map(|it| Some((it.n, value(it, is_filled)?)))
                            .collect();
                        expected.sort_by_key(|it| it.0);
                        // A curve without a mark has no label.
                        let Some((colour, _)) = styles.get(&format!("π1 = {pi1}")) else {
                            assert!(expected.is_empty(), "{what}: {styles:?}");
                            continue;
                        };
                        let mut found = marks(&picture, &panel, colour, is_filled);
                        found.sort_by(|one, two| one.0.total_cmp(&two.0));
                        assert_eq!(
                            found.len(),
                            expected.len(),
                            "{what}, {pi1}, {is_filled}: {svg}"
                        );
                        for (&(n, value), (left, up)) in expected.iter().zip(found) {
                            let what = format!("{what}, n = {n}, pi1 = {pi1}");
                            panel.x.assert_at(n as f64, left, &what);
                            if kind == Kind::Clusters {
                                assert_cluster(&panel, n, value, up, &what);
                                continue;
                            }
                            panel.y.assert_at(value, up, &what);
                            let point = these.iter().find(|it| it.n == n).unwrap();
                            let half = match (kind, is_filled) {
                                (Kind::Order, _) => point.spread(Measure::V).1,
                                (_, true) => point.interval_error(
                                    Measure::UNORDERED_TIME,
                                    Measure::UNORDERED_INTERVALS,
                                ),
                                (_, false) => point.interval_error(
                                    Measure::ORDERED_TIME,
                                    Measure::ORDERED_INTERVALS,
                                ),
                            };
                            let Some(half) = half else { continue };
                            let bar = Bar {
                                value,
                                half,
                                at: (left, up),
                            };
                            bar.assert_drawn(&picture, &panel, colour, &what);
                            bars[usize::from(kind == Kind::Order)] += 1;
                        }
                    }
                }
            }
        }
    }
    assert!(bars.iter().all(|it| *it > 500), "{bars:?}");
}

/// Checks that the size of clusters at a place gives the speed: `v_ind(n / n_eff) = v`.
fn assert_cluster(panel: &Panel, n: u64, speed: f64, up: f64, what: &str) {
    let [(from, low), .., (to, high)] = panel.y.ticks[..] else {
        panic!("{what}: {panel:?}")
    };
    let share = (up - from) / (to - from);
    let size = low * (high / low).powf(share);
    // Between whole numbers it is interpolated: the number of clusters lies between two speeds.
    let clusters = n as f64 / size;
    let [few, many] = [clusters * 0.995, clusters * 1.005].map(|it| {
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a small number"
        )]
        let whole = it as u64;
        whole.max(1)
    });
    let (fast, slow) = (v_ind(few), v_ind(many + 1));
    assert!(
        (slow - 1e-9..=fast + 1e-9).contains(&speed),
        "{what}: {clusters} clusters of {size} have a speed of {slow} to {fast}, not {speed}"
    );
}

#[test]
fn the_marks_of_random_drifts_are_at_the_values_of_their_ticks() {
    let mut drawn = 0;
    for seed in 0..200u64 {
        let what = format!("seed {seed}");
        let mut numbers = Numbers(seed);
        let all = points(&mut numbers, true);
        let rows: Vec<ResultRow> = all.iter().flat_map(|it| it.rows.clone()).collect();
        let svg = draw(Kind::Drift, &rows).unwrap();
        let picture = Picture::read(&svg);
        let styles = styles(&picture);
        for (mut panel, points) in panels(&picture, &all) {
            panel.x.logarithmic = true;
            panel.x.check();
            panel.y.check();
            for (label, (colour, _)) in styles.iter().filter(|(label, _)| label.starts_with("k/n"))
            {
                let share: f64 = label.rsplit(' ').next().unwrap().parse().unwrap();
                let of = |it: &&&Point| (it.informed as f64 / it.n as f64 - share).abs() < 6e-5;
                let mut expected: Vec<(f64, f64)> = points
                    .iter()
                    .filter(of)
                    .map(|it| (it.pi1, it.spread(Measure::V_PD).0))
                    .collect();
                let found = marks(&picture, &panel, colour, true);
                assert_eq!(found.len(), expected.len(), "{what}, {label}: {svg}");
                let bars: Vec<(f64, Option<f64>)> = points
                    .iter()
                    .filter(of)
                    .map(|it| it.spread(Measure::V_PD))
                    .collect();
                // Curves are beside each other by up to some pixels: each value has a mark of its own.
                for (left, up) in found {
                    let at = expected.iter().position(|(pi1, drift)| {
                        let near = panel
                            .x
                            .position(*pi1)
                            .is_none_or(|it| (it - left).abs() < 25.0);
                        let up_there = panel.y.position(*drift).unwrap();
                        near && (up_there - up).abs() <= panel.y.tolerance(up_there)
                    });
                    let at = at.unwrap_or_else(|| {
                        panic!(
                            "{what}, {label}: nothing is at {left}, {up}: {expected:?}, {panel:?}"
                        )
                    });
                    let (_, drift) = expected.swap_remove(at);
                    let of_it = bars.iter().find(|it| it.0 == drift).unwrap();
                    let Some(half) = of_it.1 else { continue };
                    let bar = Bar {
                        value: drift,
                        half,
                        at: (left, up),
                    };
                    bar.assert_drawn(&picture, &panel, colour, &format!("{what}, {label}"));
                    drawn += 1;
                }
                // The triangle at the right edge.
                let up = panel.y.position(share).unwrap();
                let triangle = picture.polygons.iter().any(|(corners, fill)| {
                    fill == colour
                        && (corners[0].0 - panel.right - 2.0).abs() < PIXEL
                        && (corners[0].1 - up).abs() <= panel.y.tolerance(up)
                });
                assert!(triangle, "{what}, {label}: {svg}");
            }
        }
    }
    assert!(drawn > 500, "{drawn}");
}
