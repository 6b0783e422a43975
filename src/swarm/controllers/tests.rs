#![expect(clippy::unwrap_used, reason = "tests")]

use std::sync::mpsc;
use std::time::Duration;

use jostle_physics::simulation::Spec;

use super::*;
use crate::suspension::GRACE;
use crate::swarm::handle::Rejection;
use crate::swarm::membership::{ControllerSettings, Put, Puts};

const DEADLINE: Duration = Duration::from_secs(1);

/// A paused swarm of six individuals, at a made-up time.
struct Rig {
    controllers: Controllers,
    simulation: Simulation,
    phase: Phase,
    now: Instant,
    is_replaying: bool,
    limits: TimeLimits,
    /// The controllers whose `advance` got a reply.
    replied: (mpsc::Sender<&'static str>, mpsc::Receiver<&'static str>),
}

impl Rig {
    fn new() -> Self {
        Rig {
            controllers: Controllers::default(),
            simulation: Simulation::new(&Spec::new(6, 1)).unwrap(),
            phase: Phase::Paused(PauseReason::Created),
            now: Instant::now(),
            is_replaying: false,
            limits: TimeLimits::default(),
            replied: mpsc::channel(),
        }
    }

    /// Passes an input, enters the phases that follow, and names the effects.
    fn on(&mut self, input: Input<'_>) -> Result<Vec<String>, SwarmError> {
        let mut effects = Vec::new();
        let mut swarm = Swarm {
            simulation: &mut self.simulation,
            phase: self.phase.clone(),
            now: self.now,
            is_replaying: self.is_replaying,
            effects: &mut effects,
        };
        let outcome = self.controllers.on(input, &mut swarm);
        let names = effects.into_iter().map(|effect| self.name(effect));
        let names = names.collect();
        outcome.map(|_| names)
    }

    fn name(&mut self, effect: Effect) -> String {
        match effect {
            Effect::Enter(phase) => {
                self.phase = phase;
                match self.phase.until() {
                    Some(until) => format!("step to {until}"),
                    None => format!("enter {}", self.phase.reason().unwrap()),
                }
            }
            Effect::Pause(reason) => {
                self.phase = Phase::Paused(reason);
                format!("pause {reason}")
            }
            Effect::Advanced(reply_to, from, ..) => {
                format!("{} {from}", self.receiver(reply_to))
            }
            Effect::Reject(reply_to, error) => format!("{}: {error:?}", self.receiver(reply_to)),
            Effect::Journal(None) => "journal".into(),
            Effect::Journal(Some(until)) => format!("journal to {until}"),
            Effect::Record => "record".into(),
            Effect::Publish => "publish".into(),
            Effect::PublishState => "publish state".into(),
        }
    }

    /// Joins to steer these individuals, or rejoins without any.
    fn join(
        &mut self,
        controller: &str,
        ids: &[u32],
        mode: Mode,
        on_timeout: OnTimeout,
    ) -> Result<Vec<String>, SwarmError> {
        let again = ids.is_empty();
        self.command(&Command::Join(JoinOptions {
            controller: controller.to_owned(),
            selection: (!again).then(|| Selection::Ids(ids.to_vec())),
            settings: ControllerSettings {
                mode,
                deadline: DEADLINE,
                on_timeout,
                driving: false,
            },
            again,
        }))
    }

    /// Joins in lockstep; its individuals keep their set-points if it misses a deadline.
    fn lockstep(&mut self, controller: &str, ids: &[u32]) -> Result<Vec<String>, SwarmError> {
        self.join(controller, ids, Mode::Lockstep, OnTimeout::Hold)
    }

    fn advance(&mut self, controller: &'static str, steps: u64) -> Result<Vec<String>, SwarmError> {
        let replied = self.replied.0.clone();
        let mut reply_to = ReplyTo::new(move |_| replied.send(controller).unwrap());
        let command = Command::Advance {
            controller: controller.to_owned(),
            steps,
            set: None,
        };
        self.on(Input::Command(&command, &Arc::default(), &mut reply_to))
    }

    fn command(&mut self, command: &Command) -> Result<Vec<String>, SwarmError> {
        let ignored = &mut ReplyTo::ignored();
        self.on(Input::Command(command, &Arc::default(), ignored))
    }

    fn control(
        &mut self,
        controller: &str,
        sequence: u64,
        ids: &[u32],
    ) -> Result<Vec<String>, SwarmError> {
        self.command(&Command::Control {
            controller: controller.to_owned(),
            sequence,
            set: set(ids),
        })
    }

    /// Whose advance it was.
    fn receiver(&self, reply_to: ReplyTo) -> &'static str {
        // Replies to advances that were dropped.
        self.replied.1.try_iter().for_each(drop);
        let error = SwarmError::Gone;
        reply_to.send(Err(Rejection { step: None, error }));
        self.replied.1.try_recv().unwrap()
    }

    /// Takes the steps that all have advanced by.
    fn take_steps(&mut self) -> Vec<String> {
        let until = self.phase.until().unwrap();
        while self.simulation.state.step < until {
            self.simulation.step().unwrap();
        }
        self.phase = Phase::Paused(PauseReason::Finished);
        self.on(Input::Reached).unwrap()
    }

    fn status(&self, controller: &str) -> ControllerStatus {
        let mut statuses = self.controllers.statuses(self.now).into_iter();
        statuses.find(|it| it.controller == controller).unwrap()
    }

    fn due(&self) -> Option<Instant> {
        self.controllers.due(&self.limits)
    }

    fn overdue(&self) -> Vec<(String, Expiry)> {
        self.controllers.overdue(self.now, &self.limits)
    }

    fn weight(&self, individual: usize) -> f64 {
        self.simulation.state.configuration.weight[individual]
    }
}

/// Set-points of weight 2.
fn set(ids: &[u32]) -> SetPoints {
    SetPoints {
        ids: ids.to_vec(),
        direction: vec![1.0; ids.len()],
        weight: Some(vec![2.0; ids.len()]),
        drives: None,
    }
}

fn put(sequence: u64) -> Option<Put> {
    Some(Put {
        sequence,
        set: set(&[0]),
        sender: Arc::default(),
    })
}

/// A journal of an earlier version may have such set-points.
#[test]
fn directions_without_weights_at_pi2_0_are_rejected_except_from_the_journal() {
    let mut rig = Rig::new();
    rig.lockstep("ada", &[0]).unwrap();
    rig.simulation.state.parameters.pi2 = 0.0;
    let control = |set| Command::Control {
        controller: "ada".to_owned(),
        sequence: 1,
        set,
    };
    let weightless = control(SetPoints {
        weight: None,
        ..set(&[0])
    });
    let error = rig.command(&weightless).unwrap_err();
    let informs_nobody = matches!(error, SwarmError::Change(ChangeError::Weightless));
    assert!(informs_nobody, "{error:?}");
    rig.command(&control(set(&[0]))).unwrap();
    assert_eq!(rig.weight(0), 2.0);
    rig.is_replaying = true;
    rig.command(&weightless).unwrap();
    assert_eq!(rig.weight(0), 0.0);
}

#[test]
fn it_steps_when_all_have_advanced_and_replies_to_each_at_its_step() {
    let mut rig = Rig::new();
    assert_eq!(rig.lockstep("ada", &[0]).unwrap(), ["pause lockstep"]);
    assert!(rig.lockstep("bob", &[1]).unwrap().is_empty());
    assert_eq!(rig.due(), None, "no controller waits");

    assert_eq!(rig.advance("ada", 1).unwrap(), ["journal", "record"]);
    assert_eq!(rig.due(), Some(rig.now + DEADLINE));
    rig.now += DEADLINE / 2;
    assert_eq!(rig.status("bob").waited, Some(DEADLINE / 2));
    let both = ["journal to 1", "record", "step to 1"];
    assert_eq!(rig.advance("bob", 3).unwrap(), both);
    assert_eq!(rig.due(), None);
    let error = rig.advance("ada", 1).unwrap_err();
    assert!(matches!(error, SwarmError::Advancing { target: 1, .. }));
    assert_eq!(rig.take_steps(), ["ada 0"]);
    assert_eq!(rig.due(), Some(rig.now + DEADLINE), "bob waits");
    let next = ["journal to 3", "record", "step to 3"];
    assert_eq!(rig.advance("ada", 5).unwrap(), next);
    assert_eq!(rig.take_steps(), ["bob 0"]);
}

#[test]
fn a_later_advance_and_a_rejoin_supersede_an_advance() {
    let mut rig = Rig::new();
    rig.lockstep("ada", &[0, 1]).unwrap();
    rig.lockstep("bob", &[2]).unwrap();
    rig.advance("ada", 1).unwrap();
    let again = ["ada: Superseded", "journal", "record"];
    assert_eq!(rig.advance("ada", 2).unwrap(), again);
    assert_eq!(rig.lockstep("ada", &[]).unwrap(), ["ada: Superseded"]);
    let kept = rig.status("ada").state.claims;
    assert_eq!(kept, [0, 1].into());
    let error = rig.lockstep("eve", &[1]).unwrap_err();
    assert!(matches!(error, SwarmError::Claimed { id: 1, .. }));
    let error = rig.control("bob", 1, &[0]).unwrap_err();
    assert!(
        matches!(error, SwarmError::NotClaimed { id: 0, owner: Some(owner) } if owner == "ada")
    );
}

#[test]
fn a_missed_deadline_lets_the_others_step_and_the_third_removes() {
    for (on_timeout, weight) in [(OnTimeout::Hold, 2.0), (OnTimeout::Free, 0.0)] {
        let mut rig = Rig::new();
        rig.lockstep("ada", &[0]).unwrap();
        rig.join("bob", &[1], Mode::Lockstep, on_timeout).unwrap();
        rig.control("bob", 1, &[1]).unwrap();
        for misses in 1..=3 {
            rig.advance("ada", 1).unwrap();
            assert!(rig.overdue().is_empty());
            rig.now += DEADLINE;
            assert_eq!(rig.overdue(), [("bob".to_owned(), Expiry::Deadline)]);
            let effects = rig.command(&Command::Deadline("bob".into())).unwrap();
            let step = format!("step to {misses}");
            assert_eq!(effects, ["journal", "publish", &step, "publish state"]);
            assert_eq!(rig.weight(1), weight);
            assert_eq!(rig.take_steps(), [format!("ada {}", misses - 1)]);
        }
        let error = rig.advance("bob", 1).unwrap_err();
        let late = Some((Departure::Late, 2));
        assert!(matches!(error, SwarmError::NotJoined { left, .. } if left == late));
        assert!(rig.advance("ada", 1).unwrap().contains(&"step to 4".into()));
    }
}

#[test]
fn a_missed_deadline_pauses_if_the_controller_joined_for_that() {
    let mut rig = Rig::new();
    rig.lockstep("ada", &[0]).unwrap();
    rig.join("bob", &[1], Mode::Lockstep, OnTimeout::Pause)
        .unwrap();
    rig.advance("ada", 1).unwrap();
    rig.now += DEADLINE;
    let effects = rig.command(&Command::Deadline("bob".into())).unwrap();
    let expected = [
        "journal",
        "ada 0",
        "pause deadline",
        "publish",
        "publish state",
    ];
    assert_eq!(effects, expected);
    assert_eq!(rig.due(), None);
}

#[test]
fn a_waiting_client_gets_a_reply_when_its_advance_is_interrupted() {
    let mut rig = Rig::new();
    rig.lockstep("ada", &[0]).unwrap();
    rig.join("bob", &[1], Mode::Lockstep, OnTimeout::Free)
        .unwrap();
    rig.control("bob", 1, &[1]).unwrap();
    rig.advance("ada", 1).unwrap();
    let effects = rig.command(&Command::Lost("bob".into())).unwrap();
    let expected = ["journal", "publish", "step to 1", "publish state"];
    assert_eq!(effects, expected);
    assert_eq!(rig.weight(1), 0.0);
    let effects = rig.command(&Command::Leave("ada".into())).unwrap();
    assert_eq!(effects[0], "enter lockstep", "the advance is not continued");
    assert!(effects[1].starts_with("ada: NotJoined"), "{effects:?}");

    rig.lockstep("ada", &[0]).unwrap();
    rig.lockstep("bob", &[1]).unwrap();
    rig.advance("ada", 1).unwrap();
    let paused = Phase::Paused(PauseReason::Requested);
    assert_eq!(rig.on(Input::Interrupted(paused)).unwrap(), ["ada 0"]);
    assert!(rig.on(Input::Updated).unwrap().is_empty());
    assert_eq!(rig.due(), None);

    rig.advance("ada", 1).unwrap();
    rig.phase = Phase::Faulted("no solution".into());
    let effects = rig.on(Input::Faulted(SwarmError::Gone)).unwrap();
    assert_eq!(effects, ["ada: Gone"]);
    assert_eq!(rig.due(), None, "a faulted swarm waits");
}

#[test]
fn the_lease_of_set_points_ends_and_no_other_deadline_does() {
    let mut rig = Rig::new();
    rig.join("ada", &[0], Mode::FreeRunning, OnTimeout::Free)
        .unwrap();
    let steered = rig.control("ada", 1, &[0]).unwrap();
    assert_eq!(steered, ["journal", "record"]);
    rig.on(Input::Updated).unwrap();
    assert_eq!(rig.weight(0), 2.0);
    assert_eq!(rig.due(), Some(rig.now + DEADLINE));
    rig.now += DEADLINE;
    assert_eq!(rig.overdue(), [("ada".to_owned(), Expiry::Deadline)]);
    rig.command(&Command::Deadline("ada".into())).unwrap();
    assert_eq!((rig.weight(0), rig.due()), (0.0, None));

    let steer_again = |rig: &mut Rig, sequence: u64| {
        rig.control("ada", sequence, &[0]).unwrap();
        rig.on(Input::Updated).unwrap();
        assert!(rig.due().is_some());
    };
    steer_again(&mut rig, 2);
    let reset = Phase::Paused(PauseReason::Reset);
    rig.on(Input::Restarted(reset)).unwrap();
    assert_eq!(rig.due(), None, "set-points after a reset");
    steer_again(&mut rig, 3);
    rig.command(&Command::Leave("ada".into())).unwrap();
    assert_eq!(rig.due(), None, "no controller is left");
}

#[test]
fn who_holds_the_swarm_and_sends_nothing_is_idle() {
    const IDLE: Duration = Duration::from_secs(60);
    let mut rig = Rig::new();
    rig.join("ada", &[0], Mode::Lockstep, OnTimeout::Free)
        .unwrap();
    rig.join("eve", &[1], Mode::FreeRunning, OnTimeout::Free)
        .unwrap();
    assert_eq!(rig.due(), None, "without a limit");
    rig.limits.max_idle = Some(IDLE);
    assert_eq!(
        rig.due(),
        Some(rig.now + IDLE),
        "also the only one in lockstep"
    );
    rig.now += IDLE / 2;
    rig.controllers.find("ada").unwrap().heard(rig.now);
    assert_eq!(rig.due(), Some(rig.now + IDLE), "it sent something");
    rig.advance("ada", 1).unwrap();
    assert_eq!(rig.due(), None, "while the swarm steps");
    rig.take_steps();
    rig.now += IDLE;
    assert_eq!(rig.overdue(), [("ada".to_owned(), Expiry::Idle)]);
    // Nothing before the end of a suspension counts.
    rig.limits.resumed = Some(rig.now);
    assert_eq!(rig.due(), Some(rig.now + IDLE));
    rig.control("ada", 1, &[0]).unwrap();
    rig.command(&Command::Idle("ada".into())).unwrap();
    assert_eq!((rig.weight(0), rig.due()), (0.0, None));
    let error = rig.advance("ada", 1).unwrap_err();
    assert!(error.to_string().contains("max_idle_secs"), "{error}");
}

#[test]
fn after_a_suspension_a_lost_token_may_be_declared_again() {
    let mut rig = Rig::new();
    rig.lockstep("ada", &[0]).unwrap();
    rig.lockstep("bob", &[1]).unwrap();
    rig.advance("ada", 1).unwrap();
    rig.now += 5 * DEADLINE;
    rig.limits.resumed = Some(rig.now);
    assert_eq!(
        rig.due(),
        Some(rig.now + DEADLINE),
        "it counts from the end"
    );
    rig.on(Input::Away("bob", rig.now)).unwrap();
    assert_eq!(rig.due(), Some(rig.now + GRACE), "it cannot send anything");
    rig.now += DEADLINE * 3;
    rig.on(Input::Returned("bob")).unwrap();
    assert_eq!(rig.due(), Some(rig.now + DEADLINE));
    rig.on(Input::Away("bob", rig.now)).unwrap();
    // Suspended again, before the grace was over.
    rig.now += GRACE * 2;
    rig.limits.resumed = Some(rig.now);
    assert_eq!(rig.due(), Some(rig.now + GRACE));
    rig.now += GRACE;
    assert_eq!(rig.overdue(), [("bob".to_owned(), Expiry::Lost)]);
}

#[test]
fn puts_are_counted_and_the_newest_waits_for_the_step() {
    let mut rig = Rig::new();
    rig.join("ada", &[0], Mode::FreeRunning, OnTimeout::Hold)
        .unwrap();
    let epoch = rig.simulation.epoch;
    for (epoch, put) in [
        (None, put(2)),
        (None, put(2)),
        (Some(epoch + 1), put(3)),
        (Some(epoch), put(3)),
        (None, None),
    ] {
        rig.on(Input::Put("ada", epoch, put)).unwrap();
    }
    let taken = rig.controllers.take_puts();
    assert!(matches!(
        &taken[..],
        [(Command::Control { controller, sequence: 3, .. }, _)] if controller == "ada"
    ));
    assert!(rig.control("ada", 3, &[5]).is_err());
    let expected = Puts {
        applied: 0,
        stale: 2,
        overtaken: 1,
        rejected: 2,
    };
    assert_eq!(rig.status("ada").puts, expected);
    rig.on(Input::Put("ada", None, put(3))).unwrap();
    assert_eq!(rig.status("ada").puts.stale, 3, "the applied one is newer");
}

#[test]
fn the_numbers_of_set_points_are_those_that_hold() {
    let mut rig = Rig::new();
    let sequence = |rig: &Rig| rig.controllers.sequences().get("ada").copied();
    let join = |rig: &mut Rig, ids: &[u32], mode| {
        rig.join("ada", ids, mode, OnTimeout::Free).unwrap();
    };
    join(&mut rig, &[0, 1], Mode::FreeRunning);
    assert_eq!(sequence(&rig), None);
    rig.control("ada", 4, &[0]).unwrap();
    assert_eq!(sequence(&rig), Some(4));
    assert!(rig.control("ada", 5, &[5]).is_err());
    assert_eq!(sequence(&rig), Some(4), "not those that were rejected");
    join(&mut rig, &[], Mode::FreeRunning);
    assert_eq!(sequence(&rig), Some(4), "it has rejoined");
    rig.command(&Command::Deadline("ada".into())).unwrap();
    assert_eq!(sequence(&rig), None, "its lease has ended");
    rig.control("ada", 6, &[0]).unwrap();
    rig.on(Input::Restarted(Phase::Paused(PauseReason::Reset)))
        .unwrap();
    assert_eq!(sequence(&rig), None, "after a reset");
    rig.control("ada", 7, &[0]).unwrap();
    // In lock-step its set-points have no number, and their old one is not theirs.
    join(&mut rig, &[], Mode::Lockstep);
    assert_eq!(sequence(&rig), None);
    join(&mut rig, &[], Mode::FreeRunning);
    assert_eq!(sequence(&rig), None);
    rig.control("ada", 8, &[0]).unwrap();
    assert_eq!(sequence(&rig), Some(8));
    let states = rig.controllers.states();
    let restored = Controllers::restore(states, |_| ReplyTo::ignored());
    assert_eq!(
        restored.sequences().get("ada"),
        None,
        "unknown after a restart"
    );
    rig.command(&Command::Leave("ada".into())).unwrap();
    assert_eq!(sequence(&rig), None);
}
