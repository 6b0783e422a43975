//! Axes: the mapping of values to positions, and the ticks.

/// An axis of a plot.
#[derive(Clone, Debug)]
pub struct Axis {
    /// The label beside it.
    pub label: String,
    /// Whether the axis is logarithmic.
    pub logarithmic: bool,
    /// The values at its ends, the smaller one first.
    pub ends: (f64, f64),
    /// The values of the ticks; if empty, the ticks are at round values.
    pub values: Vec<f64>,
}

/// The most decades that each have a tick on a logarithmic axis.
const MAX_DECADES: f64 = 20.0;

/// The margin beyond the outermost values, as a share of their distance.
const MARGIN: f64 = 0.05;

impl Axis {
    /// Creates an axis that spans all of `values`. Values that are not finite are ignored, on a
    /// logarithmic axis also those that are not positive.
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
                // The ratio of the ends is at least 2.5, so that the axis contains a round tick.
                let least = (2.5 * (low / high)).sqrt();
                let ratio = (libm::pow(high, MARGIN) / libm::pow(low, MARGIN)).max(least);
                // The quotient or the product may be no positive double.
                let smallest = f64::from_bits(1);
                ((low / ratio).max(smallest), (high * ratio).min(f64::MAX))
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

    /// Returns the position of `value` along the axis, from 0 at the lower to 1 at the upper end.
    /// Values beyond an end are clamped to it.
    pub fn share(&self, value: f64) -> f64 {
        let (low, high) = self.ends;
        let share = if self.logarithmic {
            let [low, high, value] = [low, high, value.max(low)].map(libm::log);
            (value - low) / (high - low)
        } else {
            (value - low) / (high - low)
        };
        share.clamp(0.0, 1.0)
    }

    /// Returns the values of the ticks with a label, and of those without.
    pub fn ticks(&self) -> (Vec<f64>, Vec<f64>) {
        let within = |value: &f64| *value >= self.ends.0 && *value <= self.ends.1;
        if !self.values.is_empty() {
            return (self.values.iter().copied().filter(within).collect(), vec![]);
        }
        if !self.logarithmic {
            let step = round_step((self.ends.1 - self.ends.0) / 7.0);
            let first = (self.ends.0 / step).ceil();
            let ticks = (0..).map(|index| (first + f64::from(index)) * step);
            return (ticks.take_while(within).collect(), vec![]);
        }
        let powers = [self.ends.0, self.ends.1].map(|end| libm::floor(libm::log10(end)));
        let stride = libm::ceil((powers[1] - powers[0]) / MAX_DECADES).max(1.0);
        let first = libm::ceil(powers[0] / stride);
        let powers = (0..)
            .map(|index| (first + f64::from(index)) * stride)
            .take_while(|it| *it <= powers[1]);
        let decades = powers.map(|power| libm::pow(10.0, power));
        let digits = if stride > 1.0 { 1..2 } else { 1..10 };
        // Over many decades only the powers of ten have space for labels.
        let labelled: &[u8] = if self.ends.1 / self.ends.0 > 2e3 {
            &[1]
        } else {
            &[1, 2, 5]
        };
        let (mut with, mut without) = (vec![], vec![]);
        for decade in decades {
            for digit in digits.clone() {
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
        // One label says nothing of other places on a logarithmic axis.
        if with.len() < 2 {
            with.append(&mut without);
            with.sort_by(f64::total_cmp);
        }
        (with, without)
    }
}

/// Formats the value of a tick, without trailing zeros.
pub fn tick_label(value: f64) -> String {
    // Twelve digits are more than an axis resolves, and hide the rounding error of 3 · 0.1.
    if value != 0.0 && !(1e-7..1e15).contains(&value.abs()) {
        let rounded = format!("{value:.11e}");
        let (digits, power) = rounded.split_once('e').unwrap_or((&rounded, "0"));
        let digits = digits.trim_end_matches('0').trim_end_matches('.');
        return format!("{digits}e{power}");
    }
    let rounded = format!("{value:.12}");
    match rounded.trim_end_matches('0').trim_end_matches('.') {
        "-0" => "0".to_owned(),
        text => text.to_owned(),
    }
}

/// Returns the smallest of 1, 2 and 5 times a power of ten that is not below `step`.
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
    fn over_many_decades_only_powers_of_ten_have_labels() {
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
        assert_eq!(labels, ["0", "0.2", "0.4", "0.6", "0.8", "1"]);
        axis.ends = (-0.3, 0.7);
        let labels: Vec<String> = axis.ticks().0.into_iter().map(tick_label).collect();
        assert_eq!(labels, ["-0.2", "0", "0.2", "0.4", "0.6"]);
    }

    #[test]
    fn an_axis_of_one_value_or_none_is_valid() {
        for logarithmic in [true, false] {
            for values in [vec![], vec![3.0]] {
                let axis = Axis::around("", logarithmic, values);
                assert!(axis.ends.0 < axis.ends.1, "{axis:?}");
                assert!(!axis.ticks().0.is_empty(), "{axis:?}");
            }
        }
    }
}
