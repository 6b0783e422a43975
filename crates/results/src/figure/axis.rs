//! Axes: from values to shares of a length, and the ticks along it.

/// What an axis measures.
#[derive(Clone, Debug)]
pub struct Axis {
    /// What stands beside it.
    pub label: String,
    /// Whether equal lengths are equal ratios, not differences.
    pub logarithmic: bool,
    /// The values at its ends, the lower first.
    pub ends: (f64, f64),
    /// Ticks at these values only; round ones if there are none.
    pub values: Vec<f64>,
}

/// The free space beyond the outermost values, as a share of their distance.
const MARGIN: f64 = 0.05;

impl Axis {
    /// An axis that has room for all of `values`; a logarithmic one passes over those not above 0.
    pub fn around(label: &str, logarithmic: bool, values: impl IntoIterator<Item = f64>) -> Self {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for value in values {
            if value.is_finite() && (value > 0.0 || !logarithmic) {
                low = low.min(value);
                high = high.max(value);
            }
        }
        let ends = match (low <= high, logarithmic) {
            (false, _) => (1.0, 10.0),
            (true, true) => {
                // Within this ratio a round tick is certain to lie.
                let least = (2.5 * low / high).sqrt();
                let ratio = libm::pow(high / low, MARGIN).max(least);
                (low / ratio, high * ratio)
            }
            (true, false) => {
                let room = MARGIN * (high - low).max(0.1);
                (low - room, high + room)
            }
        };
        Self {
            label: label.to_owned(),
            logarithmic,
            ends,
            values: Vec::new(),
        }
    }

    /// Where `value` is: 0 at the lower end, 1 at the upper, and never beyond.
    pub fn share(&self, value: f64) -> f64 {
        let (low, high) = self.ends;
        let share = if self.logarithmic {
            libm::log(value.max(low) / low) / libm::log(high / low)
        } else {
            (value - low) / (high - low)
        };
        share.clamp(0.0, 1.0)
    }

    /// The values of its ticks, those with a label first.
    pub fn ticks(&self) -> (Vec<f64>, Vec<f64>) {
        let within = |value: &f64| *value >= self.ends.0 && *value <= self.ends.1;
        if !self.values.is_empty() {
            return (self.values.iter().copied().filter(within).collect(), vec![]);
        }
        if !self.logarithmic {
            let step = round_step((self.ends.1 - self.ends.0) / 5.0);
            let first = (self.ends.0 / step).ceil();
            let ticks = (0..).map(|index| (first + f64::from(index)) * step);
            return (ticks.take_while(within).collect(), vec![]);
        }
        let decades = (-12..=12).map(|power| libm::pow(10.0, f64::from(power)));
        // Over many decades only their own ticks have room for labels.
        let labelled: &[u8] = if self.ends.1 / self.ends.0 > 2e3 {
            &[1]
        } else {
            &[1, 2, 5]
        };
        let (mut with, mut without) = (vec![], vec![]);
        for decade in decades {
            for digit in 1..10 {
                let value = decade * f64::from(digit);
                if within(&value) {
                    let ticks = if labelled.contains(&digit) {
                        &mut with
                    } else {
                        &mut without
                    };
                    ticks.push(value);
                }
            }
        }
        (with, without)
    }
}

/// Writes a value as short as it can be told from its neighbours on an axis.
pub fn tick_label(value: f64) -> String {
    // Twelve digits are more than an axis shows, and hide what rounding left of 3 · 0.1.
    let rounded = format!("{value:.12}");
    match rounded.trim_end_matches('0').trim_end_matches('.') {
        "-0" => "0".to_owned(),
        text => text.to_owned(),
    }
}

/// The least of 1, 2, 5, 10 … that is not below `step`.
fn round_step(step: f64) -> f64 {
    let decade = libm::pow(10.0, libm::floor(libm::log10(step)));
    [1.0, 2.0, 5.0]
        .into_iter()
        .map(|digit| digit * decade)
        .find(|round| *round >= step * 0.999)
        .unwrap_or(10.0 * decade)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logarithmic_ticks_are_at_1_2_and_5() {
        let mut axis = Axis::around("", true, [0.08, 1.0, 0.0, f64::NAN]);
        axis.ends = (0.08, 1.1);
        let (with, without) = axis.ticks();
        let labels: Vec<String> = with.into_iter().map(tick_label).collect();
        assert_eq!(labels, ["0.1", "0.2", "0.5", "1"]);
        assert_eq!(without.len(), 8);
        assert!((axis.share(0.08), axis.share(1.1)) == (0.0, 1.0));
        assert!((axis.share((0.08_f64 * 1.1).sqrt()) - 0.5).abs() < 1e-12);
        assert_eq!(axis.share(-1.0), 0.0);
    }

    #[test]
    fn over_many_decades_only_these_have_labels() {
        let mut axis = Axis::around("", true, [1.0]);
        axis.ends = (0.5, 5000.0);
        let (with, without) = axis.ticks();
        let labels: Vec<String> = with.into_iter().map(tick_label).collect();
        assert_eq!(labels, ["1", "10", "100", "1000"]);
        assert!(without.contains(&2000.0));
    }

    #[test]
    fn linear_ticks_are_round() {
        let mut axis = Axis::around("", false, [0.0, 1.0]);
        axis.ends = (-0.05, 1.0);
        let labels: Vec<String> = axis.ticks().0.into_iter().map(tick_label).collect();
        assert_eq!(labels, ["0", "0.5", "1"]);
        axis.ends = (-0.3, 0.7);
        let labels: Vec<String> = axis.ticks().0.into_iter().map(tick_label).collect();
        assert_eq!(labels, ["-0.2", "0", "0.2", "0.4", "0.6"]);
    }

    #[test]
    fn one_value_or_none_still_has_an_axis() {
        for logarithmic in [true, false] {
            for values in [vec![], vec![3.0]] {
                let axis = Axis::around("", logarithmic, values);
                assert!(axis.ends.0 < axis.ends.1, "{axis:?}");
                assert!(!axis.ticks().0.is_empty(), "{axis:?}");
            }
        }
    }
}
