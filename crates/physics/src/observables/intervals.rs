//! Lengths of ordered and unordered intervals: the paper's build-up and breakdown times.

/// Least order, the paper's v(t), of an ordered group.
pub const ORDERED: f64 = 2.0 / 3.0;

/// Counts the maximal intervals of consecutive ordered or unordered steps.
///
/// - Units: steps. The intervals cut by the start and by the end of a run count as well.
/// - Source: paper, Fig. 4. The build-up time is the mean length of the unordered intervals, the
///   breakdown time that of the ordered ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Intervals {
    /// Number of ordered intervals.
    pub ordered: u64,
    /// Number of steps in ordered intervals.
    pub ordered_steps: u64,
    /// Number of unordered intervals.
    pub unordered: u64,
    /// Number of steps in unordered intervals.
    pub unordered_steps: u64,
    /// Whether the last step was ordered; none before the first.
    pub last: Option<bool>,
}

impl Intervals {
    /// Counts one step; `order` is the order at its start.
    pub fn add(&mut self, order: f64) {
        let is_ordered = order >= ORDERED;
        let is_new = u64::from(self.last != Some(is_ordered));
        if is_ordered {
            self.ordered += is_new;
            self.ordered_steps += 1;
        } else {
            self.unordered += is_new;
            self.unordered_steps += 1;
        }
        self.last = Some(is_ordered);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(orders: &[f64]) -> [u64; 4] {
        let mut intervals = Intervals::default();
        orders.iter().for_each(|&order| intervals.add(order));
        let Intervals {
            ordered,
            ordered_steps,
            unordered,
            unordered_steps,
            ..
        } = intervals;
        [ordered, ordered_steps, unordered, unordered_steps]
    }

    #[test]
    fn cut_intervals_count_and_two_thirds_is_ordered() {
        assert_eq!(counted(&[]), [0, 0, 0, 0]);
        assert_eq!(counted(&[1.0; 5]), [1, 5, 0, 0]);
        assert_eq!(counted(&[0.0; 5]), [0, 0, 1, 5]);
        let orders = [0.1, 0.2, 0.7, ORDERED, ORDERED - 1e-15, 0.9];
        assert_eq!(counted(&orders), [2, 3, 2, 3]);
    }

    #[test]
    fn a_cosine_wave_has_the_expected_ordered_share() {
        // (1 + cos t) / 2 >= 2/3 if |t| <= acos(1/3). Ten periods, from a crest to a crest.
        let orders: Vec<f64> = (0..100_000)
            .map(|k| (1.0 + libm::cos(f64::from(k) * std::f64::consts::TAU * 1e-4)) / 2.0)
            .collect();
        let [ordered, ordered_steps, unordered, unordered_steps] = counted(&orders);
        assert_eq!((ordered, unordered), (11, 10));
        let share = libm::acos(1.0 / 3.0) / std::f64::consts::PI;
        assert!((ordered_steps as f64 / 1e5 - share).abs() < 2e-4);
        assert_eq!(ordered_steps + unordered_steps, 100_000);
    }
}
