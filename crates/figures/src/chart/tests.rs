//! Tests of charts.

use super::*;
use jostle_results::statistics::Spread;

fn mean(x: f64, mean: f64, error: Option<f64>, runs: usize) -> Mean {
    let deviation = error.map(|error| error * (runs as f64).sqrt());
    let spread = Spread {
        mean,
        deviation,
        error,
    };
    Mean {
        x,
        spread,
        runs,
        after_gap: false,
    }
}

fn chart(x: &str, y: &str, curves: Vec<(&str, Vec<Mean>)>) -> Chart {
    Chart {
        x: x.to_owned(),
        y: y.to_owned(),
        curves: curves
            .into_iter()
            .map(|(label, points)| MeanCurve {
                label: label.to_owned(),
                points,
            })
            .collect(),
        runs: 9,
        left_out: 0,
        empty: Vec::new(),
        ended_early: 0,
    }
}

fn svg(chart: &Chart) -> String {
    let svg = draw_chart(chart, &Labels::default()).unwrap();
    assert!(!svg.contains("NaN") && !svg.contains("inf\""), "{svg}");
    svg
}

#[test]
fn points_and_bars_are_where_their_values_are_on_the_axes() {
    let points = vec![mean(0.0, 1.0, None, 1), mean(10.0, 3.0, None, 1)];
    let svg_of_two = svg(&chart("share", "v", vec![("", points)]));
    // The axes are from -0.5 to 10.5 and 0.9 to 3.1.
    let (left, top, right, bottom) = frame(&svg_of_two);
    let x = |share: f64| left + share * (right - left);
    let y = |share: f64| bottom - share * (bottom - top);
    for (x, y) in [
        (x(0.5 / 11.0), y(0.1 / 2.2)),
        (x(10.5 / 11.0), y(2.1 / 2.2)),
    ] {
        let near = svg_of_two.lines().any(|line| {
            let number = |name| attribute(line, name).unwrap_or(f64::NAN);
            (number("cx") - x).abs() < 0.01 && (number("cy") - y).abs() < 0.01
        });
        assert!(near, "{x} {y}: {svg_of_two}");
    }
    assert!(svg_of_two.contains("1 run each"), "{svg_of_two}");
    // t(0.975, 1) = 12.706205: a bar of 2 · 12.706205, and axes of 1.1 times that.
    let one = svg(&chart(
        "share",
        "v",
        vec![("", vec![mean(1.0, 5.0, Some(1.0), 2)])],
    ));
    let (left, top, right, bottom) = frame(&one);
    let (x, middle) = (f64::midpoint(left, right), f64::midpoint(top, bottom));
    let half = (bottom - top) / 2.0 / 1.1;
    let bar = format!("{x} {:.2} {x} {:.2}", middle + half, middle - half);
    let bars: Vec<String> = lines(&one).map(|it| it.join(" ")).collect();
    let rounded = |it: &String| {
        let numbers = it.split(' ').map(|it| it.parse::<f64>().unwrap());
        numbers.map(|it| format!("{it:.2}")).collect::<Vec<_>>()
    };
    let bar = rounded(&bar);
    assert!(bars.iter().any(|it| rounded(it) == bar), "{bar:?}: {one}");
}

fn attribute(line: &str, name: &str) -> Option<f64> {
    let (_, after) = line.split_once(&format!(" {name}=\""))?;
    after.split_once('"')?.0.parse().ok()
}

/// The coordinates of each line, x and y by turns.
fn lines(svg: &str) -> impl Iterator<Item = Vec<&str>> {
    let lines = svg.lines().filter(|it| it.starts_with("<polyline"));
    lines.map(|it| it.split('"').nth(1).unwrap().split([' ', ',']).collect())
}

/// The left, top, right and bottom of the frame: the line with three points that is a corner.
fn frame(svg: &str) -> (f64, f64, f64, f64) {
    let frame = lines(svg).find(|it| it.len() == 6 && it[0] == it[2] && it[3] == it[5]);
    let numbers = frame.unwrap().into_iter().map(|it| it.parse().unwrap());
    let numbers: Vec<f64> = numbers.collect();
    (numbers[0], numbers[1], numbers[4], numbers[3])
}

#[test]
fn three_quarters_of_the_width_and_of_the_height_are_the_frame() {
    let points = || vec![mean(1.0, 1e-7, Some(1e-8), 3), mean(2.0, 3e-7, None, 1)];
    let plain = chart("dt", "worst_overlap", vec![("", points())]);
    let mut with_key = chart(
        "dt",
        "worst_overlap",
        vec![("pi1=4", points()), ("pi1=8", points())],
    );
    with_key.left_out = 3;
    let large = vec![mean(0.0, -54_321.5, None, 1), mean(99_999.0, 2.0, None, 1)];
    let wide = chart("time", "drift", vec![("", large)]);
    for chart in [plain, with_key, wide] {
        let svg = svg(&chart);
        let header = svg.lines().next().unwrap();
        let [width, height] = ["width", "height"].map(|it| attribute(header, it).unwrap());
        let (left, top, right, bottom) = frame(&svg);
        assert!(right - left >= 0.75 * width, "{} of {width}", right - left);
        assert!(
            bottom - top >= 0.75 * height,
            "{} of {height}",
            bottom - top
        );
    }
}

#[test]
fn axes_have_units_and_long_titles_several_lines() {
    let points = vec![mean(0.0, 1.0, None, 1), mean(0.1, 3.0, None, 1)];
    let labels = Labels {
        title: "a_name".repeat(10),
        units: ("v0".to_owned(), "s/v0".to_owned()),
        ..Labels::default()
    };
    let draw = |x| draw_chart(&chart(x, "v_pd", vec![("", points.clone())]), &labels).unwrap();
    let over_dt = draw("dt");
    for text in [">v_pd (v0)<", ">dt (s/v0)<", ">over dt<"] {
        assert!(over_dt.contains(text), "{text}: {over_dt}");
    }
    let title = format!(">{}: v_pd<", labels.title);
    assert!(over_dt.contains(&title), "{over_dt}");
    let over_time = draw("time");
    assert!(over_time.contains(">time (s/v0)<"), "{over_time}");
}

#[test]
fn a_chart_names_its_curves_its_interval_and_what_is_left_out() {
    let points = || {
        vec![
            mean(2.0, 3e-12, Some(1e-12), 4),
            mean(300.0, 4e-12, None, 1),
        ]
    };
    let mut data = chart(
        "n",
        "worst_residual",
        vec![("pi1=4 share=0.1", points()), ("pi1=8 share=0.1", points())],
    );
    (data.left_out, data.ended_early) = (3, 2);
    data.empty = ["n=400", "n=500"].map(str::to_owned).to_vec();
    let labels = Labels {
        title: "my_runs".to_owned(),
        units: ("body sizes".to_owned(), String::new()),
        missing: vec!["9 of 128 runs: my_runs is running".to_owned()],
    };
    let svg = draw_chart(&data, &labels).unwrap();
    for text in [
        ">my_runs: worst_residual over n<",
        ">worst_residual (1e-12 body sizes)<",
        "95 % interval of the mean",
        "1 to 4 runs each",
        "9 of 128 runs: my_runs is running. 3 of 9 runs without worst_residual are left out, all of \
         n=400 and of n=500.",
        "2 of 9 runs end before others.",
        "pi1 = 4, share = 0.1",
        "pi1 = 8, share = 0.1",
    ] {
        assert!(svg.contains(text), "{text}: {svg}");
    }
}

#[test]
fn over_time_the_interval_is_a_band() {
    let points = vec![mean(0.0, 0.0, Some(1.0), 2), mean(5.0, 1.0, Some(0.0), 2)];
    let svg = svg(&chart("time", "order", vec![("", points)]));
    assert!(svg.contains("fill-opacity"), "{svg}");
    assert!(!svg.contains("<circle"), "{svg}");
    // The time axis has no margin.
    let (left, ..) = frame(&svg);
    assert!(svg.contains(&format!("<polygon points=\"{left},")), "{svg}");
}

#[test]
fn more_curves_than_styles_are_rejected() {
    let curves = |count: usize| {
        let curve = |_| ("a=1", vec![mean(1.0, 1.0, None, 1)]);
        chart("n", "v", (0..count).map(curve).collect())
    };
    svg(&curves(MAX_CURVES));
    let rejected = draw_chart(&curves(MAX_CURVES + 1), &Labels::default()).unwrap_err();
    assert_eq!(rejected.curves, 22);
    let styles = (0..MAX_CURVES).map(|index| {
        let style = style(index, false);
        (style.colour, style.dash)
    });
    let distinct: std::collections::BTreeSet<_> = styles.collect();
    assert_eq!(distinct.len(), MAX_CURVES);
}

#[test]
fn the_power_of_ten_of_an_axis_is_that_of_the_ends_of_the_bars() {
    let label = |means: [Mean; 2]| {
        let svg = svg(&chart("share", "drift", vec![("", means.to_vec())]));
        let mut lines = svg.lines().filter(|line| line.contains(">drift"));
        let found = lines.find(|line| !line.contains(" over ")).unwrap();
        let (_, text) = found.split_once(">drift").unwrap();
        text.split_once('<').unwrap().0.to_owned()
    };
    // Means that cancel, and bars of 12.7 times their errors.
    let tiny = [mean(1.0, 1e-9, Some(0.5), 2), mean(2.0, 0.0, Some(1.0), 2)];
    assert_eq!(label(tiny), "");
    let zero = [mean(1.0, 0.0, Some(1e-7), 2), mean(2.0, 0.0, None, 1)];
    assert_eq!(label(zero), " (1e-6)");
}

#[test]
fn an_axis_of_two_values_is_linear_however_many_curves_have_them() {
    let points = || vec![mean(1.0, 0.5, None, 3), mean(100.0, 0.7, None, 3)];
    let all = ["n = 3", "n = 5", "n = 8"].map(|label| (label, points()));
    let picture = svg(&chart("noise", "order", all.into()));
    assert!(!picture.contains("logarithmic"), "{picture}");
    let more = vec![("", [points(), vec![mean(1000.0, 0.7, None, 3)]].concat())];
    assert!(svg(&chart("noise", "order", more)).contains("logarithmic"));
}
