//! The changes that a controller makes between two steps: directions, weights and drives.

use std::collections::BTreeSet;

use super::{ChangeError, SetPoints, Simulation};
use crate::model::Drive;
use crate::model::parameters::{check_coordinate, check_share, check_weight};
use crate::model::selection::{Candidates, SelectionError};

impl Simulation {
    /// Sets directions, weights and drives of individuals: of all of them, or of none if it fails.
    ///
    /// A drive with neither turning rate nor speed removes the drive of its individual.
    ///
    /// - Shapes: columns of one length.
    ///
    /// # Errors
    ///
    /// [`ChangeError::Column`] for columns of unequal lengths, [`ChangeError::Selection`] for an unknown
    /// id, [`ChangeError::Parameters`] for a value outside its range. The simulation is then unchanged.
    pub fn steer(&mut self, set: &SetPoints) -> Result<(), ChangeError> {
        let SetPoints {
            ids,
            direction,
            weight,
            drives,
        } = set;
        for (column, length) in [
            ("direction", Some(direction.len())),
            ("weight", weight.as_ref().map(Vec::len)),
            ("drives", drives.as_ref().map(Vec::len)),
        ] {
            if let Some(length) = length
                && length != ids.len()
            {
                let ids = ids.len();
                return Err(ChangeError::Column {
                    column,
                    length,
                    ids,
                });
            }
        }
        let usual = self.state.parameters.pi2;
        let weight_of = |k: usize| weight.as_ref().map_or(usual, |weight| weight[k]);
        let configuration = &self.state.configuration;
        let mut individuals = Vec::with_capacity(ids.len());
        let mut largest = configuration.largest_weight();
        for (k, id) in ids.iter().enumerate() {
            check_coordinate("set.direction", direction[k])?;
            check_weight("set.weight", weight_of(k))?;
            largest = largest.max(weight_of(k));
            if let Some(Drive { turn, speed }) = drives.as_ref().map(|drives| drives[k]) {
                turn.map_or(Ok(()), |turn| check_coordinate("set.turn", turn))?;
                speed.map_or(Ok(()), |speed| check_share("set.speed", speed))?;
            }
            let index = configuration.id.binary_search(id);
            let candidates = configuration.n();
            individuals.push(index.map_err(|_| SelectionError::UnknownId {
                id: *id,
                candidates,
                among: Candidates::All,
            })?);
        }
        self.state.parameters.check(largest)?;
        for (k, &individual) in individuals.iter().enumerate() {
            let configuration = &mut self.state.configuration;
            configuration.inform(individual, weight_of(k), direction[k], None);
            if let Some(drives) = drives {
                match drives[k] {
                    Drive {
                        turn: None,
                        speed: None,
                    } => drop(configuration.drives.remove(&ids[k])),
                    drive => drop(configuration.drives.insert(ids[k], drive)),
                }
            }
        }
        Ok(())
    }

    /// Makes the individuals uninformed and removes their drives. Unknown ids are ignored.
    pub fn release(&mut self, ids: &BTreeSet<u32>) {
        let configuration = &mut self.state.configuration;
        for id in ids {
            if let Ok(individual) = configuration.id.binary_search(id) {
                configuration.uninform(individual);
                configuration.drives.remove(id);
            }
        }
    }
}

#[cfg(test)]
#[expect(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::simulation::tests::row;

    #[test]
    fn set_points_apply_to_all_or_none_and_are_released() {
        let mut swarm = row(&[0.0; 3]);
        let drive = Drive {
            turn: Some(0.5),
            speed: None,
        };
        let none = Drive {
            turn: None,
            speed: None,
        };
        let mut points = SetPoints {
            ids: vec![2, 0],
            direction: vec![1.0, 2.0],
            weight: None,
            drives: Some(vec![drive, none]),
        };
        swarm.steer(&points).unwrap();
        let pi2 = swarm.state.parameters.pi2;
        assert_eq!(swarm.state.configuration.weight, [pi2, 0.0, pi2]);
        assert_eq!(swarm.state.configuration.direction, [2.0, 0.0, 1.0]);
        assert!(swarm.state.configuration.drives.keys().eq([&2]));
        points.weight = Some(vec![0.25, 0.5]);
        points.drives = None;
        swarm.steer(&points).unwrap();
        assert_eq!(swarm.state.configuration.weight, [0.5, 0.0, 0.25]);
        assert!(swarm.state.configuration.drives.keys().eq([&2]));

        let hash = swarm.state_hash();
        let mut unknown = points.clone();
        unknown.ids[1] = 9;
        let error = swarm.steer(&unknown).unwrap_err();
        let ChangeError::Selection(SelectionError::UnknownId {
            id: 9,
            candidates: 3,
            ..
        }) = error
        else {
            panic!("{error:?}");
        };
        for (direction, weight, turn, speed) in [
            (f64::NAN, 0.5, 0.0, 0.5),
            (0.0, -0.5, 0.0, 0.5),
            (0.0, 1e9, 0.0, 0.5),
            (0.0, 0.5, f64::INFINITY, 0.5),
            (0.0, 0.5, 0.0, 1.5),
        ] {
            let drive = Drive {
                turn: Some(turn),
                speed: Some(speed),
            };
            let rejected = SetPoints {
                ids: vec![0, 1],
                direction: vec![0.0, direction],
                weight: Some(vec![0.5, weight]),
                drives: Some(vec![none, drive]),
            };
            let error = swarm.steer(&rejected).unwrap_err();
            assert!(matches!(error, ChangeError::Parameters(_)), "{error:?}");
        }
        let columns = |directions, weights, drives| SetPoints {
            ids: vec![0, 1],
            direction: vec![0.0; directions],
            weight: Some(vec![0.5; weights]),
            drives: Some(vec![drive; drives]),
        };
        for (unequal, name) in [
            (columns(1, 2, 2), "direction"),
            (columns(3, 2, 2), "direction"),
            (columns(2, 0, 2), "weight"),
            (columns(2, 2, 3), "drives"),
        ] {
            let error = swarm.steer(&unequal).unwrap_err();
            let ChangeError::Column { column, ids: 2, .. } = error else {
                panic!("{error:?}");
            };
            assert_eq!(column, name);
        }
        assert_eq!(swarm.state_hash(), hash);

        swarm.release(&BTreeSet::from([2, 9]));
        assert_eq!(swarm.state.configuration.weight, [0.5, 0.0, 0.0]);
        assert!(swarm.state.configuration.drives.is_empty());
    }
}
