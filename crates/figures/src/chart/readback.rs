//! Charts of random tables and series, read back from their pictures.

use std::collections::BTreeMap;

use jostle_results::chart::{over_time, over_value};
use jostle_results::table::{MeasureSeries, Series};
use jostle_results::{ExtraValue, Measure, ResultRow};

use super::*;
use crate::reading::{PIXEL, Panel as Read, Picture, styles};
use crate::tests::sample;

/// A sequence of numbers that a seed determines.
pub struct Numbers(pub u64);

impl Numbers {
    pub fn below(&mut self, end: u64) -> u64 {
        let next = self.0.wrapping_mul(6_364_136_223_846_793_005);
        self.0 = next.wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % end
    }

    pub fn share(&mut self) -> f64 {
        self.below(1 << 20) as f64 / f64::from(1 << 20)
    }

    pub fn of<T: Copy>(&mut self, all: &[T]) -> T {
        all[usize::try_from(self.below(all.len() as u64)).unwrap()]
    }
}

/// 97.5 % quantiles of Student's t distribution, from a table: those of 1 to 4 degrees of freedom.
const QUANTILES: [f64; 4] = [12.706_204_736, 4.302_652_730, 3.182_446_305, 2.776_445_105];

/// The mean and half the length of its interval, as the documentation defines them.
pub fn by_hand(values: &[f64]) -> (f64, Option<f64>) {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    if values.len() == 1 {
        return (mean, None);
    }
    let squares: f64 = values.iter().map(|it| (it - mean).powi(2)).sum();
    let error = (squares / (count - 1.0) / count).sqrt();
    (mean, Some(error * QUANTILES[values.len() - 2]))
}

/// The values of each point of a curve: the points without a value are empty.
type Points = Vec<(f64, Vec<f64>)>;

/// The stretches of points that have values.
fn stretches(points: &Points) -> Vec<Points> {
    let parts = points.split(|(_, values)| values.is_empty());
    let parts = parts.filter(|it| !it.is_empty());
    parts.map(<[(f64, Vec<f64>)]>::to_vec).collect()
}

fn drawn(svg: &str) -> (Picture, Read) {
    assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    let picture = Picture::read(svg);
    let mut panels = picture.panels();
    assert_eq!(panels.len(), 1, "{svg}");
    let panel = panels.remove(0);
    panel.x.check();
    panel.y.check();
    (picture, panel)
}

/// The colour and dashes of each curve by its label, those of the only mark if there is no key.
fn colours(picture: &Picture, labels: &[String]) -> Vec<(String, String)> {
    if labels.len() == 1 && labels[0].is_empty() {
        let mut lines = picture
            .lines
            .iter()
            .filter(|it| it.colour.starts_with("#0"));
        let line = lines.next().map(|it| it.colour.clone());
        let circle = picture.circles.first().map(|it| it.outline.clone());
        return vec![(line.or(circle).unwrap(), String::new())];
    }
    let styles = styles(picture);
    assert_eq!(styles.len(), labels.len(), "{styles:?}");
    let of = |label: &String| {
        let text = label.replace(' ', ", ").replace('=', " = ");
        styles
            .get(&text)
            .unwrap_or_else(|| panic!("{text}: {styles:?}"))
            .clone()
    };
    labels.iter().map(of).collect()
}

/// A table over one value, and the values of each curve by its label.
fn table(numbers: &mut Numbers) -> (Vec<ResultRow>, String, String, Vec<(String, Points)>) {
    let y = numbers.of(&["v", "v_pd", "milling", "worst_residual"]);
    let x = numbers.of(&["share", "n", "pi3", "noise"]);
    let count = 1 + numbers.below(11);
    let is_wide = numbers.below(2) > 0;
    let mut places: Vec<f64> = Vec::new();
    for index in 0..count {
        let place = match (x, is_wide) {
            ("n", true) => 2.0 * 3f64.powi(i32::try_from(index).unwrap()),
            ("n", false) => 3.0 + index as f64,
            (_, true) => {
                10f64.powi(i32::try_from(index).unwrap() - 13) * (1.0 + index as f64 / 16.0)
            }
            ("share", false) => -1.0 + 0.375 * index as f64,
            _ => 0.25 * (index + 1) as f64,
        };
        places.push(place);
    }
    let scale = 10f64.powi(i32::try_from(numbers.below(24)).unwrap() - 14);
    let offset = numbers.of(&[0.0, 0.0, 1.0, -1.0, 30.0]);
    let others: &[&str] = match numbers.below(4) {
        0 => &[""],
        1 => &["attraction=0.5", "attraction=10"],
        2 => &["contacts=closest", "contacts=endpoints"],
        _ => &[
            "attraction=1 depth=2",
            "attraction=1 depth=10",
            "attraction=2 depth=2",
        ],
    };
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for other in others {
        let mut points = Points::new();
        for &place in &places {
            let mut values = Vec::new();
            // A condition may be missing from the table.
            if numbers.below(8) == 0 && places.len() > 3 {
                continue;
            }
            let is_without = numbers.below(5) == 0;
            for replicate in 0..1 + numbers.below(4) {
                let value = scale * (offset + 2.0 * numbers.share() - 1.0);
                let is_without = is_without || numbers.below(6) == 0;
                let may_lack = ["v_pd", "milling"].contains(&y);
                let value = (!may_lack || !is_without).then_some(value);
                let axes = [format!("{x}={place}"), (*other).to_owned()];
                let mut axes: Vec<String> = axes.into_iter().filter(|it| !it.is_empty()).collect();
                axes.sort();
                let mut row = ResultRow {
                    run: format!("{} #{replicate}", axes.join(" ")),
                    ..sample()
                };
                if x == "share" {
                    let name = x.to_owned();
                    let value = Some(place);
                    row.extra.push(ExtraValue { name, value });
                }
                if y == "milling" {
                    let name = y.to_owned();
                    row.extra.push(ExtraValue { name, value });
                } else {
                    let measure = Measure::ALL
                        .iter()
                        .find(|it| it.column().name == y)
                        .unwrap();
                    row.set(*measure, value.into());
                }
                values.extend(value);
                rows.push(row);
            }
            points.push((place, values));
        }
        curves.push(((*other).to_owned(), points));
    }
    for _ in 0..rows.len() {
        let (one, two) = (
            numbers.below(rows.len() as u64),
            numbers.below(rows.len() as u64),
        );
        rows.swap(usize::try_from(one).unwrap(), usize::try_from(two).unwrap());
    }
    (rows, x.to_owned(), y.to_owned(), curves)
}

#[test]
fn the_marks_and_bars_of_random_tables_are_at_the_values_of_their_ticks() {
    let (mut logarithmic, mut single, mut scaled, mut gaps, mut bars_seen) = (0, 0, 0, 0, 0);
    for seed in 0..400u64 {
        let mut numbers = Numbers(seed);
        let (rows, x, y, mut curves) = table(&mut numbers);
        let what = format!("seed {seed}: {y} over {x}");
        curves.retain(|(_, points)| points.iter().any(|(_, values)| !values.is_empty()));
        let with_value = curves.iter().flat_map(|(_, points)| points);
        let mut places: Vec<f64> = with_value
            .filter(|(_, values)| !values.is_empty())
            .map(|(place, _)| *place)
            .collect();
        places.sort_by(f64::total_cmp);
        places.dedup();
        let chart = over_value(&rows, &y, Some(&x));
        if places.is_empty() || places.len() == 1 && rows.len() > 1 {
            assert!(chart.is_err(), "{what}");
            continue;
        }
        let chart = chart.unwrap_or_else(|error| panic!("{what}: {error}"));
        let svg = draw_chart(&chart, &Labels::default()).unwrap();
        let (picture, panel) = drawn(&svg);
        logarithmic += usize::from(panel.x.logarithmic);
        single += usize::from(places.len() == 1);
        scaled += usize::from(panel.y.factor != 1.0);
        let labels: Vec<String> = curves.iter().map(|(label, _)| label.clone()).collect();
        // The key of one curve among several conditions is shown as well.
        let found = colours(&picture, &labels);
        let all = curves
            .iter()
            .map(|(_, points)| points.iter().filter(|it| !it.1.is_empty()).count());
        assert_eq!(
            picture.circles.len(),
            all.sum::<usize>()
                + if labels[0].is_empty() {
                    0
                } else {
                    labels.len()
                },
            "{what}: {svg}"
        );
        for (index, ((label, points), (colour, dash))) in curves.iter().zip(&found).enumerate() {
            let what = format!("{what}, {label}");
            let aside = ASIDE * (index as f64 - (curves.len() - 1) as f64 / 2.0);
            let in_frame =
                |at: &(f64, f64)| (panel.top - PIXEL..=panel.bottom + PIXEL).contains(&at.1);
            let marks = picture
                .circles
                .iter()
                .filter(|it| it.fill == *colour && in_frame(&it.at));
            let mut marks: Vec<(f64, f64)> = marks.map(|it| it.at).collect();
            marks.sort_by(|one, two| one.0.total_cmp(&two.0));
            let expected = points.iter().filter(|it| !it.1.is_empty());
            let expected: Vec<(f64, (f64, Option<f64>))> = expected
                .map(|(place, values)| (*place, by_hand(values)))
                .collect();
            assert_eq!(marks.len(), expected.len(), "{what}: {svg}");
            let upright = picture.lines.iter().filter(|it| {
                it.colour == *colour
                    && it.width == 1.0
                    && it.points.len() == 2
                    && it.points[0].0 == it.points[1].0
            });
            let upright: Vec<_> = upright.collect();
            let bars = expected
                .iter()
                .filter(|(_, (_, half))| half.is_some())
                .count();
            assert_eq!(upright.len(), bars, "{what}");
            bars_seen += bars;
            for (&(place, (mean, half)), &(left, up)) in expected.iter().zip(&marks) {
                panel.x.assert_at(place, left - aside, &what);
                panel.y.assert_at(mean, up, &what);
                let Some(half) = half else { continue };
                let bar = upright.iter().find(|it| {
                    let [low, high] = [it.points[0], it.points[1]];
                    (low.0 - left).abs() < PIXEL
                        && (f64::midpoint(low.1, high.1) - up).abs() < 3.0 * PIXEL
                });
                let bar = bar.unwrap_or_else(|| panic!("{what}: no bar at {place}: {svg}"));
                panel.y.assert_at(mean - half, bar.points[0].1, &what);
                panel.y.assert_at(mean + half, bar.points[1].1, &what);
            }
            // Joined by lines, but not over a place without a value.
            let lines = picture.lines.iter().filter(|it| {
                it.colour == *colour
                    && it.dash == *dash
                    && it.width == 2.0
                    && it.points.iter().all(in_frame)
            });
            let lines: Vec<_> = lines.map(|it| it.points.clone()).collect();
            let stretches = stretches(points);
            gaps += stretches.len() - 1;
            let mut rest = &marks[..];
            let mut expected = Vec::new();
            for stretch in stretches {
                let (these, others) = rest.split_at(stretch.len());
                rest = others;
                if these.len() > 1 {
                    expected.push(these.to_vec());
                }
            }
            assert_eq!(lines, expected, "{what}: {svg}");
        }
    }
    assert!(
        logarithmic > 40 && scaled > 60 && gaps > 40 && bars_seen > 1000,
        "{logarithmic} logarithmic, {single} of one place, {scaled} scaled, {gaps} gaps, {bars_seen} bars"
    );
}

#[test]
fn a_chart_of_one_run_has_its_mark_at_its_values() {
    for value in [0.0, -3.0, 0.7, 1e-13, 2e9, 5e-324, 1e308] {
        for place in [0.0, -2.5, 1e-14, 3e17, 5e-324, 1e308] {
            let name = "share".to_owned();
            let mut row = ResultRow {
                run: format!("share={place} #0"),
                ..sample()
            };
            row.extra.push(ExtraValue {
                name,
                value: Some(place),
            });
            row.set(Measure::V, value.into());
            let chart = over_value(&[row], "v", Some("share")).unwrap();
            let (picture, panel) = drawn(&draw_chart(&chart, &Labels::default()).unwrap());
            let [mark] = &picture.circles[..] else {
                panic!("{picture:?}")
            };
            panel.x.assert_at(place, mark.at.0, "x");
            panel.y.assert_at(value, mark.at.1, "y");
        }
    }
}

/// Rows with a value at each place, as the command line reads them.
fn rows_at(places: &[f64]) -> Vec<ResultRow> {
    let row = |(index, place): (usize, &f64)| {
        let mut row = ResultRow {
            run: format!("noise={place:e} #0"),
            ..sample()
        };
        row.set(Measure::V, (index as f64).into());
        row
    };
    places.iter().enumerate().map(row).collect()
}

#[test]
fn points_of_extreme_ranges_are_in_the_frame_at_their_places() {
    let least = f64::from_bits(1);
    let mut all = vec![
        vec![1e-300, 1e-200, 1e-10, 1.0],
        vec![1e-290, 1e-100, 1.0],
        vec![1e-300, 1.0, 1e300],
        vec![least, 1e-150, f64::MAX],
        vec![least, 3.0 * least, 40.0 * least],
        vec![1e307, 1e308, f64::MAX],
        vec![1e306, 1e308, f64::MAX],
        vec![1e-300, f64::MAX],
        vec![least, f64::MAX],
        vec![least, 2.0 * least],
        // More places than have a tick each.
        (0..60).map(|power| 10f64.powi(10 * power - 300)).collect(),
        (0..20)
            .map(|index| 1e307 * f64::from(index % 17 + 1))
            .collect(),
    ];
    let mut numbers = Numbers(3);
    let mut random = || {
        let count = 3 + numbers.below(20);
        let mut place = || loop {
            let bits = (numbers.below(1 << 31) << 32) | numbers.below(1 << 31);
            let place = f64::from_bits(bits);
            if place.is_finite() && place > 0.0 {
                return place;
            }
        };
        (0..count).map(|_| place()).collect::<Vec<f64>>()
    };
    all.extend((0..200).map(|_| random()));
    let mut logarithmic = 0;
    for places in all {
        let chart = over_value(&rows_at(&places), "v", Some("noise")).unwrap();
        let svg = draw_chart(&chart, &Labels::default()).unwrap();
        let (picture, panel) = drawn(&svg);
        logarithmic += usize::from(panel.x.logarithmic);
        let mut sorted = places.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.dedup();
        assert_eq!(picture.circles.len(), sorted.len(), "{places:?}");
        assert!(panel.x.ticks.len() > 1, "{places:?}: {svg}");
        for (place, mark) in sorted.iter().zip(&picture.circles) {
            let is_inside = (panel.left..=panel.right).contains(&mark.at.0);
            assert!(is_inside, "{place} of {places:?}: {mark:?}");
            panel.x.assert_at(*place, mark.at.0, &format!("{places:?}"));
        }
        let upright =
            |it: &&crate::reading::Line| it.points.len() == 2 && it.points[0].0 == it.points[1].0;
        assert!(
            picture.lines.iter().filter(upright).count() < 200,
            "{places:?}"
        );
    }
    assert!(logarithmic > 200, "{logarithmic}");
}

/// The series of random conditions, and the values of each regular time.
fn all_series(numbers: &mut Numbers) -> (Vec<Series>, Vec<(String, Points)>) {
    let every = 1 + numbers.below(40);
    let dt = numbers.of(&[0.02, 0.1, 0.0005]);
    let entries = 2 + numbers.below(14);
    let scale = 10f64.powi(i32::try_from(numbers.below(20)).unwrap() - 12);
    let offset = numbers.of(&[0.0, 1.0, -5.0]);
    let conditions: &[&str] = match numbers.below(3) {
        0 => &[""],
        1 => &["n=3", "n=20"],
        _ => &[
            "n=3 share=0.1",
            "n=3 share=0.5",
            "n=20 share=0.1",
            "n=20 share=0.5",
        ],
    };
    let (mut all, mut curves) = (Vec::new(), Vec::new());
    for condition in conditions {
        let mut values: BTreeMap<u64, Vec<f64>> = BTreeMap::new();
        let undefined: Vec<bool> = (0..entries).map(|_| numbers.below(4) == 0).collect();
        for replicate in 0..1 + numbers.below(4) {
            let end = match numbers.below(5) {
                0 => 1 + numbers.below(entries),
                _ => entries,
            };
            let never = numbers.below(6) == 0;
            let (mut steps, mut these) = (Vec::new(), Vec::new());
            for index in 0..end {
                let step = index * every;
                let is_without =
                    never || undefined[usize::try_from(index).unwrap()] || numbers.below(9) == 0;
                let value = scale * (offset + 2.0 * numbers.share() - 1.0);
                let value = (!is_without).then_some(value);
                steps.push(step);
                these.push(value);
                values.entry(step).or_default().extend(value);
            }
            all.push(Series {
                run: format!("{condition} #{replicate}").trim().to_owned(),
                times: steps.iter().map(|step| *step as f64 * dt).collect(),
                steps,
                measures: vec![MeasureSeries {
                    name: "drift".to_owned(),
                    values: these,
                }],
            });
        }
        let points = values
            .into_iter()
            .map(|(step, values)| (step as f64 * dt, values));
        curves.push(((*condition).to_owned(), points.collect()));
    }
    (all, curves)
}

#[test]
fn the_curves_and_bands_of_random_series_are_at_the_values_of_their_ticks() {
    let (mut gaps, mut alone, mut scaled) = (0, 0, 0);
    for seed in 0..400u64 {
        let mut numbers = Numbers(1000 + seed);
        let (all, mut curves) = all_series(&mut numbers);
        let what = format!("seed {seed}");
        curves.retain(|(_, points)| points.iter().any(|(_, values)| !values.is_empty()));
        let chart = over_time(&all, "drift");
        if curves.is_empty() {
            assert!(chart.is_err(), "{what}");
            continue;
        }
        let chart = chart.unwrap();
        let svg = draw_chart(&chart, &Labels::default()).unwrap();
        let (picture, panel) = drawn(&svg);
        assert_eq!(panel.x.label, "time (s/v0)");
        scaled += usize::from(panel.y.factor != 1.0);
        let labels: Vec<String> = curves.iter().map(|(label, _)| label.clone()).collect();
        for ((label, points), (colour, dash)) in curves.iter().zip(colours(&picture, &labels)) {
            let what = format!("{what}, {label}: {svg}");
            let lines = picture
                .lines
                .iter()
                .filter(|it| it.colour == colour && it.dash == dash && it.width == 1.5);
            let mut lines: Vec<_> = lines.map(|it| it.points.clone()).collect();
            let dots = picture.circles.iter().filter(|it| it.fill == colour);
            lines.extend(dots.map(|it| vec![it.at]));
            lines.sort_by(|one, two| one[0].0.total_cmp(&two[0].0));
            let polygons = picture.polygons.iter().filter(|it| it.1 == colour);
            let polygons: Vec<_> = polygons.map(|it| &it.0).collect();
            let stretches = stretches(points);
            assert_eq!(
                (lines.len(), polygons.len()),
                (stretches.len(), stretches.len()),
                "{what}"
            );
            gaps += stretches.len() - 1;
            for ((stretch, line), polygon) in stretches.iter().zip(&lines).zip(polygons) {
                alone += usize::from(stretch.len() == 1);
                assert_eq!(
                    (line.len(), polygon.len()),
                    (stretch.len(), 2 * stretch.len()),
                    "{what}"
                );
                let (upper, lower) = polygon.split_at(stretch.len());
                for (index, (time, values)) in stretch.iter().enumerate() {
                    let (mean, half) = by_hand(values);
                    let half = half.unwrap_or(0.0);
                    panel.y.assert_at(mean, line[index].1, &what);
                    panel.y.assert_at(mean + half, upper[index].1, &what);
                    panel
                        .y
                        .assert_at(mean - half, lower[stretch.len() - 1 - index].1, &what);
                    for at in [line[index], upper[index], lower[stretch.len() - 1 - index]] {
                        if panel.x.ticks.len() > 1 {
                            panel.x.assert_at(*time, at.0, &what);
                        }
                    }
                }
            }
        }
    }
    assert!(
        gaps > 100 && alone > 50 && scaled > 100,
        "{gaps} gaps, {alone} alone, {scaled} scaled"
    );
}
