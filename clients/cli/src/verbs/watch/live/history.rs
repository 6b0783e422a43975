//! Order, drift and a measure over time, in bounded memory.

/// The number of points kept: more than the widest chart has dots.
const MAX_POINTS: usize = 1024;

/// One sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    pub time: f64,
    pub order: f64,
    /// The drift, if there was a direction.
    pub drift: Option<f64>,
    /// The chosen measure, if there is one and it is defined.
    pub measure: Option<f64>,
}

/// The samples of one epoch, oldest first. When there are too many, every second one is dropped,
/// so that the chart shows the whole time.
#[derive(Debug, Default)]
pub struct History {
    points: Vec<Point>,
    epoch: u64,
    /// The least time between two points.
    spacing: f64,
}

impl History {
    /// Adds a sample. A later epoch clears the history; late samples are ignored.
    pub fn add(&mut self, epoch: u64, point: Point) {
        if epoch > self.epoch {
            *self = History::default();
        }
        if let Some(last) = self.points.last() {
            if epoch < self.epoch || point.time < last.time {
                return;
            }
            if point.time == last.time {
                self.points.pop();
            } else if point.time - last.time < self.spacing {
                return;
            }
        }
        self.epoch = epoch;
        self.points.push(point);
        if self.points.len() > MAX_POINTS {
            let mut index = 0;
            self.points.retain(|_| {
                index += 1;
                index % 2 == 1
            });
            let (first, last) = (self.points[0].time, self.points[self.points.len() - 1].time);
            self.spacing = (last - first) / (self.points.len() - 1) as f64;
        }
    }

    /// Removes the values of the measure, because another one is chosen.
    pub fn forget_measure(&mut self) {
        for point in &mut self.points {
            point.measure = None;
        }
    }

    /// The points, oldest first.
    pub fn points(&self) -> &[Point] {
        &self.points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(time: f64) -> Point {
        Point {
            time,
            order: 0.5,
            drift: None,
            measure: None,
        }
    }

    #[test]
    fn it_is_bounded_and_keeps_its_first_sample() {
        let mut history = History::default();
        for step in 0..100_000 {
            history.add(1, at(f64::from(step) * 0.02));
        }
        let points = history.points();
        assert!(
            (MAX_POINTS / 3..=MAX_POINTS).contains(&points.len()),
            "{}",
            points.len()
        );
        assert_eq!(points[0], at(0.0));
        assert!(points.is_sorted_by(|a, b| a.time < b.time));
        assert!(points[points.len() - 1].time > 1990.0);
    }

    #[test]
    fn a_later_epoch_clears_the_history() {
        let mut history = History::default();
        history.add(1, at(0.0));
        history.add(1, at(1.0));
        history.add(1, at(1.0));
        assert_eq!(history.points().len(), 2, "equal times count once");
        history.add(1, at(0.5));
        assert_eq!(history.points().len(), 2, "a late sample");
        history.add(2, at(0.7));
        history.add(1, at(1.1));
        assert_eq!(history.points(), [at(0.7)], "another epoch");
    }
}
