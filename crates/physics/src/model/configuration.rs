//! All individuals at one step, as columns ordered by id.

use std::collections::BTreeMap;

/// The spacing of origins, in body sizes. Positions are stored relative to an origin.
pub const CELL: f64 = 1024.0;

/// Direct control of one individual, beyond the paper. Each field that is set replaces that part
/// of the free motion; contacts act on the individual as on any other.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Drive {
    /// Turning rate, angle over time; limited to ±ω, the
    /// [`turning_rate_scale`](super::Parameters::turning_rate_scale).
    pub turn: Option<f64>,
    /// Factor of the free speed, from 0 to 1.
    pub speed: Option<f64>,
}

/// All positions, angles and preferences at one step.
///
/// Every column has one entry per individual; ids strictly increase. An individual's absolute
/// position is `CELL * origin + (x, y)`, in body sizes. Angles are in radians and are never
/// wrapped. Uninformed individuals have weight and direction 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Configuration {
    /// The cell to whose origin positions are relative.
    pub origin: [i64; 2],
    /// The id of the next new individual; ids are not reused.
    pub next_id: u32,
    /// Stable ids of the individuals.
    pub id: Vec<u32>,
    /// Centres, relative to the origin.
    pub x: Vec<f64>,
    /// Centres, relative to the origin.
    pub y: Vec<f64>,
    /// Headings, counter-clockwise from +x.
    pub alpha: Vec<f64>,
    /// Weight of the individual's preference; 0 if it is uninformed.
    pub weight: Vec<f64>,
    /// Preferred direction of an informed individual, counter-clockwise from +x.
    pub direction: Vec<f64>,
    /// The step at whose end the individual becomes uninformed.
    pub lapses_at: Vec<Option<u64>>,
    /// Drives of the individuals that are driven directly, by id.
    pub drives: BTreeMap<u32, Drive>,
}

impl Configuration {
    /// Returns the number of individuals.
    #[must_use]
    pub fn n(&self) -> usize {
        self.id.len()
    }

    /// Returns the largest weight present, 0 if no individual is informed.
    #[must_use]
    pub fn largest_weight(&self) -> f64 {
        self.weight
            .iter()
            .fold(0.0, |largest, &weight| f64::max(largest, weight))
    }

    /// Returns the mean position, relative to the origin.
    #[must_use]
    pub fn centroid(&self) -> [f64; 2] {
        let count = self.n().max(1) as f64;
        [
            self.x.iter().sum::<f64>() / count,
            self.y.iter().sum::<f64>() / count,
        ]
    }

    /// Converts an absolute position to one relative to the origin.
    #[must_use]
    pub fn relative(&self, absolute: [f64; 2]) -> [f64; 2] {
        [
            absolute[0] - CELL * self.origin[0] as f64,
            absolute[1] - CELL * self.origin[1] as f64,
        ]
    }

    /// Shifts positions by whole cells on each axis on which the centroid is further than half a
    /// cell from the origin, so that doubles resolve a step wherever the group is.
    pub fn re_centre(&mut self) {
        let centroid = self.centroid();
        for (axis, column) in [&mut self.x, &mut self.y].into_iter().enumerate() {
            if centroid[axis].abs() <= CELL / 2.0 {
                continue;
            }
            let cells = libm::round(centroid[axis] / CELL);
            column.iter_mut().for_each(|value| *value -= CELL * cells);
            #[expect(
                clippy::cast_possible_truncation,
                reason = "positions are far below 2^63 cells"
            )]
            let cells = cells as i64;
            self.origin[axis] += cells;
        }
    }

    /// Appends an uninformed individual and returns its id.
    ///
    /// # Panics
    ///
    /// When no id is left; callers check that before.
    pub fn push(&mut self, x: f64, y: f64, alpha: f64) -> u32 {
        let id = self.next_id;
        self.next_id = id.checked_add(1).expect("callers check that ids suffice");
        self.id.push(id);
        self.x.push(x);
        self.y.push(y);
        self.alpha.push(alpha);
        self.weight.push(0.0);
        self.direction.push(0.0);
        self.lapses_at.push(None);
        id
    }

    /// Gives individual `index` a preferred direction; weight 0 makes it uninformed.
    pub fn inform(&mut self, index: usize, weight: f64, direction: f64, lapses_at: Option<u64>) {
        let informed = weight > 0.0;
        self.weight[index] = weight;
        self.direction[index] = if informed { direction } else { 0.0 };
        self.lapses_at[index] = if informed { lapses_at } else { None };
    }

    /// Removes the preferred direction of individual `index`.
    pub fn uninform(&mut self, index: usize) {
        self.inform(index, 0.0, 0.0, None);
    }

    /// Removes the individuals at `indices`, in any order; the others keep order and ids.
    pub fn remove(&mut self, indices: &[usize]) {
        let mut kept = vec![true; self.n()];
        indices.iter().for_each(|&index| kept[index] = false);
        retain(&mut self.id, &kept);
        retain(&mut self.x, &kept);
        retain(&mut self.y, &kept);
        retain(&mut self.alpha, &kept);
        retain(&mut self.weight, &kept);
        retain(&mut self.direction, &kept);
        retain(&mut self.lapses_at, &kept);
        let ids = &self.id;
        self.drives.retain(|id, _| ids.binary_search(id).is_ok());
    }
}

fn retain<T>(column: &mut Vec<T>, kept: &[bool]) {
    let mut flags = kept.iter();
    column.retain(|_| *flags.next().expect("columns have equal lengths"));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn three() -> Configuration {
        let mut configuration = Configuration::default();
        for k in 0..3 {
            configuration.push(f64::from(k), 10.0 * f64::from(k), 0.1 * f64::from(k));
        }
        configuration
    }

    #[test]
    fn removal_keeps_order_and_ids_are_not_reused() {
        let mut configuration = three();
        configuration.inform(2, 0.5, 1.0, Some(9));
        configuration.remove(&[1, 0]);
        assert_eq!(configuration.id, [2]);
        assert_eq!((configuration.x[0], configuration.y[0]), (2.0, 20.0));
        assert_eq!(
            (configuration.weight[0], configuration.lapses_at[0]),
            (0.5, Some(9))
        );
        assert_eq!(configuration.push(0.0, 0.0, 0.0), 3);
        assert_eq!(configuration.largest_weight(), 0.5);
    }

    #[test]
    fn a_weight_of_zero_is_uninformed_for_any_direction() {
        let mut configuration = three();
        configuration.inform(1, 0.5, 1.0, Some(9));
        configuration.inform(1, 0.0, 2.0, Some(9));
        assert_eq!(configuration, three());
    }

    #[test]
    fn re_centring_moves_by_whole_cells_and_keeps_absolute_positions() {
        let mut configuration = three();
        configuration.x = vec![511.0, 512.0, 513.0];
        configuration.re_centre();
        assert_eq!(configuration.origin, [0, 0], "exactly half a cell stays");
        configuration.x = vec![2559.0, 2560.0, 2565.0];
        configuration.y = vec![-600.0, -600.0, -600.0];
        configuration.re_centre();
        assert_eq!(configuration.origin, [3, -1]);
        assert_eq!(configuration.x, [-513.0, -512.0, -507.0]);
        assert_eq!(configuration.y, [424.0, 424.0, 424.0]);
        assert_eq!(configuration.relative([2559.0, -600.0]), [-513.0, 424.0]);
    }
}
