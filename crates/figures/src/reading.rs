//! A reader of drawn figures for tests: values from the places of marks and the labels of ticks.

use std::collections::BTreeMap;

/// A place in pixels.
pub type Place = (f64, f64);

/// The places of pixels are written to a hundredth.
pub const PIXEL: f64 = 0.011;

/// The elements of a picture.
#[derive(Debug, Default)]
pub struct Picture {
    pub lines: Vec<Line>,
    pub circles: Vec<Circle>,
    pub polygons: Vec<(Vec<Place>, String)>,
    pub texts: Vec<Text>,
}

#[derive(Clone, Debug)]
pub struct Line {
    pub points: Vec<Place>,
    pub colour: String,
    pub dash: String,
    pub width: f64,
}

#[derive(Clone, Debug)]
pub struct Circle {
    pub at: Place,
    pub fill: String,
    pub outline: String,
}

#[derive(Clone, Debug)]
pub struct Text {
    pub at: Place,
    pub anchor: String,
    pub text: String,
}

/// The frame of a panel with its axes.
#[derive(Debug)]
pub struct Panel {
    pub left: f64,
    pub top: f64,
    pub right: f64,
    pub bottom: f64,
    pub x: Scale,
    pub y: Scale,
}

/// An axis as its ticks say it: their positions in pixels and their values.
#[derive(Debug)]
pub struct Scale {
    pub label: String,
    pub ticks: Vec<(f64, f64)>,
    pub logarithmic: bool,
    /// The number by which its label says that values are multiplied.
    pub factor: f64,
}

fn attribute<'a>(line: &'a str, name: &str) -> Option<&'a str> {
    let (_, after) = line.split_once(&format!(" {name}=\""))?;
    Some(after.split_once('"')?.0)
}

fn number(line: &str, name: &str) -> f64 {
    let text = attribute(line, name).unwrap_or_else(|| panic!("{name}: {line}"));
    text.parse().unwrap_or_else(|_| panic!("{name}: {line}"))
}

fn places(line: &str) -> Vec<Place> {
    let pairs = attribute(line, "points").unwrap().split(' ');
    let pairs = pairs.map(|it| it.split_once(',').unwrap());
    pairs
        .map(|(x, y)| (x.parse().unwrap(), y.parse().unwrap()))
        .collect()
}

/// The text between tags.
fn plain(line: &str) -> String {
    let mut text = String::new();
    let mut inside = false;
    for letter in line.chars() {
        match letter {
            '<' => inside = true,
            '>' => inside = false,
            _ if !inside => text.push(letter),
            _ => {}
        }
    }
    text
}

impl Picture {
    pub fn read(svg: &str) -> Self {
        let mut picture = Self::default();
        let own = |line: &str, name| attribute(line, name).unwrap_or_default().to_owned();
        for line in svg.lines() {
            if line.starts_with("<polyline") {
                picture.lines.push(Line {
                    points: places(line),
                    colour: own(line, "stroke"),
                    dash: own(line, "stroke-dasharray"),
                    width: number(line, "stroke-width"),
                });
            } else if line.starts_with("<circle") {
                picture.circles.push(Circle {
                    at: (number(line, "cx"), number(line, "cy")),
                    fill: own(line, "fill"),
                    outline: own(line, "stroke"),
                });
            } else if line.starts_with("<polygon") {
                picture.polygons.push((places(line), own(line, "fill")));
            } else if line.starts_with("<text") {
                picture.texts.push(Text {
                    at: (number(line, "x"), number(line, "y")),
                    anchor: own(line, "text-anchor"),
                    text: plain(line),
                });
            }
        }
        picture
    }

    /// Its panels in the order of reading: a frame is a line with a corner, left and below.
    pub fn panels(&self) -> Vec<Panel> {
        let frames = self.lines.iter().filter(|it| match it.points[..] {
            [one, corner, end] => one.0 == corner.0 && corner.1 == end.1 && it.colour == "#222222",
            _ => false,
        });
        frames
            .map(|frame| {
                let [(left, top), (_, bottom), (right, _)] = frame.points[..] else {
                    panic!("{frame:?}")
                };
                let x = self.scale((left, top, right, bottom), true);
                let y = self.scale((left, top, right, bottom), false);
                Panel {
                    left,
                    top,
                    right,
                    bottom,
                    x,
                    y,
                }
            })
            .collect()
    }

    /// The axis of a frame. Each label of a tick must be beside a line across the frame.
    fn scale(&self, (left, top, right, bottom): (f64, f64, f64, f64), is_x: bool) -> Scale {
        let across: Vec<f64> = self
            .lines
            .iter()
            .filter_map(|it| match it.points[..] {
                [one, two] if is_x && one.0 == two.0 => {
                    ((one.1, two.1) == (top, bottom) && within(one.0, left, right)).then_some(one.0)
                }
                [one, two] if !is_x && one.1 == two.1 => {
                    ((one.0, two.0) == (left, right) && within(one.1, top, bottom)).then_some(one.1)
                }
                _ => None,
            })
            .collect();
        let mut ticks = Vec::new();
        for text in &self.texts {
            let Ok(value) = text.text.parse::<f64>() else {
                continue;
            };
            let at = match (is_x, text.anchor.as_str()) {
                (true, "middle") if (text.at.1 - bottom - 20.0).abs() < PIXEL => text.at.0,
                (false, "end") if (text.at.0 - left + 9.0).abs() < PIXEL => text.at.1 - 4.5,
                _ => continue,
            };
            if is_x && !within(at, left, right) || !is_x && !within(at, top, bottom) {
                continue;
            }
            assert!(
                across.iter().any(|it| (it - at).abs() < 2.0 * PIXEL),
                "no tick at the label {value}, {at}: {across:?}"
            );
            ticks.push((at, value));
        }
        ticks.sort_by(|one, two| one.0.total_cmp(&two.0));
        let labels = self.texts.iter().filter(|text| {
            is_x && (text.at.1 - bottom - 42.0).abs() < PIXEL && within(text.at.0, left, right)
        });
        let label = match is_x {
            true => labels.map(|it| it.text.clone()).next().unwrap(),
            // The one that rises beside the frame.
            false => {
                let middle = f64::midpoint(top, bottom);
                let mut beside = self.texts.iter().filter(|it| {
                    it.anchor == "middle" && (it.at.1 - middle).abs() < PIXEL && it.at.0 < left
                });
                beside.next_back().unwrap().text.clone()
            }
        };
        let unit = label.split_once('(').map(|(_, unit)| unit);
        let first = unit.and_then(|it| it.split([' ', ')']).next());
        Scale {
            logarithmic: label.contains("(logarithmic)"),
            factor: first.and_then(|it| it.parse().ok()).unwrap_or(1.0),
            label,
            ticks,
        }
    }
}

fn within(value: f64, low: f64, high: f64) -> bool {
    (low - PIXEL..=high + PIXEL).contains(&value)
}

impl Scale {
    fn along(&self, value: f64) -> f64 {
        if self.logarithmic { value.ln() } else { value }
    }

    /// Checks that the ticks between the outermost two are where they are by these.
    pub fn check(&self) {
        let [(from, low), .., (to, high)] = self.ticks[..] else {
            assert_eq!(self.ticks.len(), 1, "{self:?}");
            return;
        };
        for &(at, value) in &self.ticks {
            let share =
                (self.along(value) - self.along(low)) / (self.along(high) - self.along(low));
            let expected = from + share * (to - from);
            assert!(
                (at - expected).abs() < 4.0 * PIXEL,
                "{value} at {at}: {self:?}"
            );
        }
    }

    /// The position of a value, by the outermost two ticks; none unless there are two.
    pub fn position(&self, value: f64) -> Option<f64> {
        let [(from, low), .., (to, high)] = self.ticks[..] else {
            return None;
        };
        let low = self.along(low);
        let share = (self.along(value / self.factor) - low) / (self.along(high) - low);
        Some(from + share * (to - from))
    }

    /// The tolerance of a position in pixels: that of two ticks, more beyond them.
    pub fn tolerance(&self, position: f64) -> f64 {
        let [(from, _), .., (to, _)] = self.ticks[..] else {
            return PIXEL;
        };
        let share = (position - from) / (to - from);
        2.0 * PIXEL * (1.0 + share.abs().max((1.0 - share).abs()))
    }

    /// Whether a value is at a position. With one tick only its value has a known position.
    #[track_caller]
    pub fn assert_at(&self, value: f64, at: f64, what: &str) {
        let expected = self.position(value).unwrap_or_else(|| {
            let [(at, tick)] = self.ticks[..] else {
                panic!("no ticks: {self:?}")
            };
            assert!(
                (tick * self.factor - value).abs() <= 1e-9 * value.abs(),
                "{what}: {self:?}"
            );
            at
        });
        assert!(
            (at - expected).abs() <= self.tolerance(expected),
            "{what}: {value} is at {at}, not at {expected}: {self:?}"
        );
    }
}

/// The texts of a key or beside the ends of curves with the colour and the dashes of the line before each.
pub fn styles(picture: &Picture) -> BTreeMap<String, (String, String)> {
    let mut styles = BTreeMap::new();
    for line in &picture.lines {
        let [one, two] = line.points[..] else {
            continue;
        };
        if one.1 != two.1 || line.width != 2.0 {
            continue;
        }
        let beside = picture.texts.iter().find(|text| {
            text.anchor == "start"
                && (text.at.1 - one.1 - 4.5).abs() < 2.0 * PIXEL
                && (5.0..8.0).contains(&(text.at.0 - two.0))
        });
        if let Some(text) = beside {
            styles.insert(text.text.clone(), (line.colour.clone(), line.dash.clone()));
        }
    }
    styles
}
