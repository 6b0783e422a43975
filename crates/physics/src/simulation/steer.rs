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
    /// [`ChangeError::Selection`] for an unknown id, [`ChangeError::Parameters`] for a value
    /// outside its range.
    pub fn steer(&mut self, set: &SetPoints) -> Result<(), ChangeError> {
        let SetPoints {
            ids,
            direction,
            weight,
            drives,
        } = set;
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
