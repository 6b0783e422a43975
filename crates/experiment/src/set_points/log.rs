//! Collects the set-points of a swarm, and writes them as a CSV.

use std::collections::{BTreeMap, HashMap};
use std::fmt::Write as _;

use jostle_physics::model::Drive;

use super::{COLUMNS, MODEL, SetPoint};
use crate::limits::MAX_SET_POINTS;

/// The set-points that were applied to a swarm. Those that changed nothing are left out, and of
/// several between two commands for the same individual only what they did together is kept.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SetPointLog {
    /// By step, by the number of commands applied at that step before, and by individual.
    rows: BTreeMap<(u64, u64, u32), SetPoint>,
    /// The last set-points since the last command.
    last: HashMap<u32, SetPoint>,
    /// Whether there are more than are kept.
    is_full: bool,
}

impl SetPointLog {
    /// Adds a set-point, at a step after so many of its commands.
    pub fn push(&mut self, step: u64, after: u64, id: u32, point: SetPoint) {
        if self.last.insert(id, point).map(bits) == Some(bits(point)) {
            return;
        }
        let key = (step, after, id);
        let point = match self.rows.get(&key) {
            Some(earlier) => together(*earlier, point),
            None => point,
        };
        self.is_full |= self.rows.len() as u64 > MAX_SET_POINTS;
        if !self.is_full {
            self.rows.insert(key, point);
        }
    }

    /// Notes that a command was applied.
    pub fn changed(&mut self) {
        self.last.clear();
    }

    /// Removes all set-points, because the swarm was reset.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Returns whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Returns whether there are more than a run may have.
    #[must_use]
    pub fn is_too_long(&self) -> bool {
        self.is_full || self.rows.len() as u64 > MAX_SET_POINTS
    }

    /// Returns the last step at which there are some.
    #[must_use]
    pub fn last_step(&self) -> Option<u64> {
        self.rows.last_key_value().map(|((step, ..), _)| *step)
    }

    /// Returns the CSV. `commands` is the number of commands at a step: `after` is left out if all
    /// set-points follow all commands of their step.
    pub(crate) fn csv(&self, commands: impl Fn(u64) -> u64) -> String {
        let is_last = |(step, after): (u64, u64)| after >= commands(step);
        let has_after = !self
            .rows
            .keys()
            .all(|(step, after, _)| is_last((*step, *after)));
        let has_drive = self.rows.values().any(|point| match point {
            SetPoint::Steer { drive, .. } => drive.is_some(),
            SetPoint::Release => false,
        });
        let columns = COLUMNS.iter().filter(|column| match **column {
            "turn" | "speed" => has_drive,
            "after" => has_after,
            _ => true,
        });
        let columns: Vec<&str> = columns.copied().collect();
        let mut csv = columns.join(",") + "\n";
        for ((step, after, id), point) in &self.rows {
            let (direction, weight, drive) = match *point {
                SetPoint::Release => (None, None, None),
                SetPoint::Steer {
                    direction,
                    weight,
                    drive,
                } => (Some(direction), weight, drive),
            };
            let _ = write!(csv, "{step},{id},{},{}", cell(direction), cell(weight));
            if has_drive {
                let driven =
                    |value: Option<f64>| value.map_or(MODEL.to_owned(), |it| it.to_string());
                let [turn, speed] = drive.map_or([String::new(), String::new()], |drive| {
                    [driven(drive.turn), driven(drive.speed)]
                });
                let _ = write!(csv, ",{turn},{speed}");
            }
            if has_after {
                let after = match is_last((*step, *after)) {
                    true => String::new(),
                    false => after.to_string(),
                };
                let _ = write!(csv, ",{after}");
            }
            csv.push('\n');
        }
        csv
    }
}

fn cell(value: Option<f64>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}

/// Returns the bits that a set-point writes into the state, whose hash contains the sign of zero.
fn bits(point: SetPoint) -> impl PartialEq {
    let SetPoint::Steer {
        direction,
        weight,
        drive,
    } = point
    else {
        return None;
    };
    let drive = drive.map(|it| [it.turn, it.speed].map(|value| value.map(f64::to_bits)));
    Some((direction.to_bits(), weight.map(f64::to_bits), drive))
}

/// Returns what two set-points of an individual do together.
fn together(earlier: SetPoint, later: SetPoint) -> SetPoint {
    match (earlier, later) {
        (
            SetPoint::Release,
            SetPoint::Steer {
                direction,
                weight,
                drive: None,
            },
        ) => SetPoint::Steer {
            direction,
            weight,
            drive: Some(Drive {
                turn: None,
                speed: None,
            }),
        },
        (
            SetPoint::Steer { drive, .. },
            SetPoint::Steer {
                direction,
                weight,
                drive: None,
            },
        ) => SetPoint::Steer {
            direction,
            weight,
            drive,
        },
        (_, later) => later,
    }
}
