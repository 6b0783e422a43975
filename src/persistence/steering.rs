//! What the controllers of a swarm do with its individuals, read from its journal.

use std::collections::{BTreeMap, BTreeSet};

use jostle_experiment::SetPoint;
use jostle_physics::model::selection::Selection;
use jostle_physics::simulation::SetPoints;

use crate::swarm::command::Command;
use crate::swarm::membership::{
    ControllerSettings, ControllerState, JoinOptions, MAX_MISSES, Mode, OnTimeout,
};

/// The controllers of a swarm with the individuals that they steer.
#[derive(Default)]
pub struct Steering(BTreeMap<String, Member>);

struct Member {
    settings: ControllerSettings,
    /// The individuals that it has steered.
    steered: BTreeSet<u32>,
    /// Deadlines that it has missed since its last command.
    misses: u32,
    /// Whether some of `steered` are perhaps not its own: it joined again with individuals that were
    /// drawn from the state.
    is_uncertain: bool,
}

impl Member {
    fn new(settings: ControllerSettings, steered: BTreeSet<u32>, misses: u32) -> Self {
        Member {
            settings,
            steered,
            misses,
            is_uncertain: false,
        }
    }
}

impl Steering {
    /// The controllers of a checkpoint.
    pub fn of(controllers: &[(String, ControllerState)]) -> Self {
        let member = |(name, state): &(String, ControllerState)| {
            let steered = state.steered.iter().copied().collect();
            let member = Member::new(state.settings, steered, state.misses);
            (name.clone(), member)
        };
        Steering(controllers.iter().map(member).collect())
    }

    /// The swarm was reset: its individuals are new.
    pub fn reset(&mut self) {
        for member in self.0.values_mut() {
            member.steered.clear();
            member.is_uncertain = false;
        }
    }

    /// Reads an applied command of a controller. Returns what it did with individuals. The error is
    /// the reason if that is unknown.
    pub fn on(&mut self, command: Command) -> Result<Vec<(u32, SetPoint)>, String> {
        match command {
            Command::Join(options) => self.join(options),
            Command::Advance {
                controller, set, ..
            } => return Ok(self.steer(&controller, set.as_ref())),
            Command::Control {
                controller, set, ..
            } => return Ok(self.steer(&controller, Some(&set))),
            Command::Leave(controller) | Command::Lost(controller) | Command::Idle(controller) => {
                return self.remove(&controller);
            }
            Command::Deadline(controller) => return self.miss(&controller),
            Command::Run { .. }
            | Command::Pause
            | Command::Step(_)
            | Command::Reset(_)
            | Command::Change(_)
            | Command::Batch { .. }
            | Command::Annotate
            | Command::Protect(_)
            | Command::Watch(_)
            | Command::Unwatch(_)
            | Command::Fired(_)
            | Command::Delete => {}
        }
        Ok(Vec::new())
    }

    fn join(&mut self, options: JoinOptions) {
        let before = self.0.remove(&options.controller);
        let steered = before.as_ref().map(|it| it.steered.clone());
        let mut member = Member::new(options.settings, steered.unwrap_or_default(), 0);
        member.is_uncertain = before.is_some_and(|it| it.is_uncertain);
        match options.selection {
            None => {}
            Some(Selection::Ids(ids)) => {
                let ids = BTreeSet::from_iter(ids);
                member.steered.retain(|id| ids.contains(id));
            }
            Some(_) => member.is_uncertain |= !member.steered.is_empty(),
        }
        self.0.insert(options.controller, member);
    }

    fn steer(&mut self, controller: &str, set: Option<&SetPoints>) -> Vec<(u32, SetPoint)> {
        let member = self.0.get_mut(controller);
        if let Some(member) = member {
            member.misses = 0;
            member.steered.extend(set.iter().flat_map(|set| &set.ids));
        }
        let points = set.into_iter().flat_map(|set| {
            let point = move |k: usize| SetPoint::Steer {
                direction: set.direction[k],
                weight: set.weight.as_ref().map(|weight| weight[k]),
                drive: set.drives.as_ref().map(|drives| drives[k]),
            };
            (0..set.ids.len()).map(move |k| (set.ids[k], point(k)))
        });
        points.collect()
    }

    /// A controller has left.
    fn remove(&mut self, controller: &str) -> Result<Vec<(u32, SetPoint)>, String> {
        match self.0.remove(controller) {
            Some(member) if member.settings.on_timeout != OnTimeout::Hold => {
                released(controller, &member)
            }
            _ => Ok(Vec::new()),
        }
    }

    /// A controller has missed its deadline.
    fn miss(&mut self, controller: &str) -> Result<Vec<(u32, SetPoint)>, String> {
        let Some(member) = self.0.get_mut(controller) else {
            return Ok(Vec::new());
        };
        member.misses += 1;
        let mut points = Vec::new();
        if member.settings.on_timeout == OnTimeout::Free {
            points = released(controller, member)?;
            member.steered.clear();
            member.is_uncertain = false;
        }
        if member.settings.mode == Mode::Lockstep && member.misses >= MAX_MISSES {
            points.extend(self.remove(controller)?);
        }
        Ok(points)
    }
}

/// Returns what happens to individuals that a controller steers no longer.
fn released(controller: &str, member: &Member) -> Result<Vec<(u32, SetPoint)>, String> {
    if member.is_uncertain {
        return Err(format!(
            "the controller {controller} joined again with other individuals, so it is not known \
             which of them it released: reset the swarm"
        ));
    }
    let ids = member.steered.iter();
    Ok(ids.map(|id| (*id, SetPoint::Release)).collect())
}
