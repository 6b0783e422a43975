//! How the individuals of two states differ.

use std::f64::consts::{PI, TAU};

use jostle_proto::State;
use serde::Serialize;

use crate::format;

/// One unit of the origin, in body sizes.
const CELL: f64 = 1024.0;

/// The most ids printed.
const MAX_SHOWN: usize = 10;

/// Differences of individuals; distances in body sizes, angles in radians.
#[derive(Debug, Default, PartialEq, Serialize)]
pub struct Bodies {
    /// The number of common individuals.
    pub common: usize,
    /// Individuals that only the first has.
    pub only_one: Vec<u32>,
    /// Individuals that only the second has.
    pub only_other: Vec<u32>,
    /// The number of common individuals that are not bit-identical.
    pub differ: usize,
    /// The number of common individuals with another weight or direction.
    pub informed_otherwise: usize,
    /// The root mean square of the distances between the positions in both.
    pub rms_distance: f64,
    /// The largest of these distances.
    pub largest_distance: f64,
    /// The individual with this distance; `null` if all are 0.
    pub furthest: Option<u32>,
    /// The largest angle between the headings in both.
    pub largest_turn: f64,
}

/// Compares the individuals of two states by id.
pub fn compare(one: &State, other: &State) -> Bodies {
    // Differences of origins are whole numbers, which keeps precision far from the origin.
    let offset: [f64; 2] = [0, 1].map(|axis| (other.origin[axis] - one.origin[axis]) as f64 * CELL);
    let mut bodies = Bodies::default();
    let mut squares = 0.0;
    let (mut i, mut j) = (0, 0);
    loop {
        match (one.id.get(i), other.id.get(j)) {
            (None, None) => break,
            (Some(a), Some(b)) if a == b => {
                let (dx, dy) = (
                    other.x[j] - one.x[i] + offset[0],
                    other.y[j] - one.y[i] + offset[1],
                );
                let distance = dx.hypot(dy);
                let turn = wrapped(other.alpha[j] - one.alpha[i]).abs();
                let is_informed_otherwise = one.weight[i].to_bits() != other.weight[j].to_bits()
                    || one.direction[i].to_bits() != other.direction[j].to_bits();
                let is_same = distance == 0.0
                    && one.alpha[i].to_bits() == other.alpha[j].to_bits()
                    && !is_informed_otherwise;
                bodies.common += 1;
                bodies.differ += usize::from(!is_same);
                bodies.informed_otherwise += usize::from(is_informed_otherwise);
                squares += distance * distance;
                if distance > bodies.largest_distance {
                    (bodies.largest_distance, bodies.furthest) = (distance, Some(*a));
                }
                bodies.largest_turn = bodies.largest_turn.max(turn);
                (i, j) = (i + 1, j + 1);
            }
            (Some(a), Some(b)) if b < a => {
                bodies.only_other.push(*b);
                j += 1;
            }
            (Some(a), _) => {
                bodies.only_one.push(*a);
                i += 1;
            }
            (None, Some(b)) => {
                bodies.only_other.push(*b);
                j += 1;
            }
        }
    }
    if bodies.common > 0 {
        bodies.rms_distance = (squares / bodies.common as f64).sqrt();
    }
    bodies
}

/// An angle as one from -π to π.
pub fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

impl Bodies {
    pub fn describe(&self) -> String {
        let mut lines = vec![format!(
            "{} of {} differ; apart by {} body sizes at most{}, {} rms; turned by {} \
             at most",
            self.differ,
            format::count(self.common as u64, "individual"),
            format::magnitude(Some(self.largest_distance)),
            match self.furthest {
                Some(id) => format!(" (id {id})"),
                None => String::new(),
            },
            format::magnitude(Some(self.rms_distance)),
            format::magnitude(Some(self.largest_turn)),
        )];
        if self.informed_otherwise > 0 {
            lines.push(format!("{} informed otherwise", self.informed_otherwise));
        }
        for (ids, whose) in [(&self.only_one, "first"), (&self.only_other, "second")] {
            if !ids.is_empty() {
                let shown = format::ids(&ids[..ids.len().min(MAX_SHOWN)]);
                let more = if ids.len() > MAX_SHOWN { ",…" } else { "" };
                lines.push(format!("{} only in the {whose} ({shown}{more})", ids.len()));
            }
        }
        lines.join("\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;

    fn state(origin: [i64; 2], id: &[u32], x: &[f64], alpha: &[f64]) -> State {
        let zeros = vec![0.0; id.len()];
        State {
            origin,
            id: id.to_vec(),
            x: x.to_vec(),
            y: zeros.clone(),
            alpha: alpha.to_vec(),
            weight: zeros.clone(),
            direction: zeros,
            ..fixtures::state()
        }
    }

    #[test]
    fn individuals_are_compared_by_id_whatever_the_origin() {
        let one = state([0, 0], &[1, 2, 4], &[0.0, 1023.0, 9.0], &[0.0, 0.0, 3.0]);
        let other = state([1, 0], &[2, 3, 4], &[-1.0, 5.0, -1011.0], &[0.0, 0.0, -3.0]);
        let bodies = compare(&one, &other);
        assert_eq!((bodies.common, bodies.differ), (2, 1));
        assert_eq!(bodies.only_one, [1]);
        assert_eq!(bodies.only_other, [3]);
        assert_eq!(bodies.furthest, Some(4));
        assert_eq!(bodies.largest_distance.to_bits(), 4.0_f64.to_bits());
        assert!((bodies.rms_distance - 8.0_f64.sqrt()).abs() < 1e-15);
        assert!((bodies.largest_turn - (TAU - 6.0)).abs() < 1e-12);
    }

    #[test]
    fn a_different_weight_or_direction_is_counted() {
        let one = state([0, 0], &[1, 2, 3], &[0.0; 3], &[0.0; 3]);
        let mut other = one.clone();
        other.weight[0] = 0.5;
        other.direction[1] = 1.0;
        let bodies = compare(&one, &other);
        assert_eq!((bodies.informed_otherwise, bodies.differ), (2, 2));
    }

    #[test]
    fn a_state_and_itself_do_not_differ() {
        let one = state([0, 0], &[1, 2], &[0.5, 7.0], &[0.25, 0.0]);
        let bodies = compare(&one, &one);
        assert_eq!(
            (bodies.common, bodies.differ, bodies.furthest),
            (2, 0, None)
        );
    }
}
