//! How the individuals of two states differ.

use std::f64::consts::{PI, TAU};

use jostle_proto::State;
use serde::Serialize;

use crate::format;

/// How much one unit of the origin is, in body sizes.
const CELL: f64 = 1024.0;

/// The most ids that people are shown.
const MOST_SHOWN: usize = 10;

/// How individuals differ; distances in body sizes, turns in radians.
#[derive(Debug, PartialEq, Serialize)]
pub struct Bodies {
    /// How many both have.
    pub common: usize,
    /// Those that only the first has.
    pub only_one: Vec<u32>,
    /// Those that only the second has.
    pub only_other: Vec<u32>,
    /// How many of the common are not the same to the bit.
    pub differ: usize,
    /// How many of the common are informed otherwise.
    pub informed_otherwise: usize,
    /// The root of the mean square of the distances between the places of each in both.
    pub rms_distance: f64,
    /// The largest of these distances.
    pub largest_distance: f64,
    /// Whose that is; `null` if all are 0.
    pub furthest: Option<u32>,
    /// The largest turn between the headings of each in both.
    pub largest_turn: f64,
}

/// Compares the individuals of two states by id.
pub fn compare(one: &State, other: &State) -> Bodies {
    // Differences of origins are whole numbers, so nothing is lost far out.
    let offset: [f64; 2] = [0, 1].map(|axis| (other.origin[axis] - one.origin[axis]) as f64 * CELL);
    let mut bodies = Bodies {
        common: 0,
        only_one: Vec::new(),
        only_other: Vec::new(),
        differ: 0,
        informed_otherwise: 0,
        rms_distance: 0.0,
        largest_distance: 0.0,
        furthest: None,
        largest_turn: 0.0,
    };
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

/// An angle between -π and π.
pub fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}

impl Bodies {
    /// In words.
    pub fn words(&self) -> String {
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
                let shown = format::ids(&ids[..ids.len().min(MOST_SHOWN)]);
                let more = if ids.len() > MOST_SHOWN { ",…" } else { "" };
                lines.push(format!("{} only in the {whose} ({shown}{more})", ids.len()));
            }
        }
        lines.join("\n")
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use serde_json::json;

    use super::*;

    fn state(origin: [i64; 2], id: &[u32], x: &[f64], alpha: &[f64]) -> State {
        let zeros = vec![0.0; id.len()];
        serde_json::from_value(json!({
            "swarm": "demo", "epoch": 1, "frame": 0, "step": 0, "time": 0.0, "phase": "paused",
            "origin": origin, "id": id, "x": x, "y": zeros, "alpha": alpha, "weight": zeros,
            "direction": zeros,
            "order": {
                "order": 0.0, "mean_order": null, "velocity": [0.0, 0.0], "mean_velocity": null,
                "direction": null, "drift": null, "mean_drift": null,
            },
            "certificate": {
                "worst_gap": null, "residual": 0.0, "degraded": 0, "crossed": 0, "contacts": 0,
                "iterations": 0,
            },
        }))
        .unwrap()
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
