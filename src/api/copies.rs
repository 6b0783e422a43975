//! Swarms made as others were, and a swarm's past told again: fork, restore, verify.

use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::thread;
use std::time::Duration;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use jostle_physics::simulation::ReserveError;
use jostle_proto::verbs::{ForkArgs, RestoreArgs};
use jostle_proto::{Request, Verified, keys};
use zenoh::query::Query;

use crate::api::commands::{self, CommandError, DEFAULT_TIMEOUT, check_name, selector};
use crate::api::context::Clerk;
use crate::api::responder::{Asked, Keeper, Promise};
use crate::convert::{self, Payload, sanity};
use crate::persistence::recovery::{self, Retold};
use crate::persistence::writer::{self, MakePayload};
use crate::swarm::checkpoint::Checkpoint;
use crate::swarm::frame::Place;
use crate::swarm::handle::{Handle, Ticket};
use crate::swarm::outcome::{Answer, OrderError, Outcome, Refusal};
use crate::swarm::phase::{PauseReason, Phase};
use crate::swarm::registry::{Host, Register};
use crate::swarm::worker::replay::To;

/// What stands around a snapshot in the request to restore it, in bytes.
const BYTES_AROUND_SNAPSHOT: usize = 4096;

/// How long a history may be told again before its asker hears that it takes longer.
const PATIENCE_WITH_HISTORY: Duration = Duration::from_secs(3600);

impl Clerk {
    /// Makes a swarm as another one is, or as it was on arriving at a step.
    pub(crate) fn fork(&self, swarm: &Arc<str>, asked: &Asked) {
        let query = &asked.query;
        let key = query.key_expr().as_str().to_owned();
        let promise = self.desk.promise(asked, key.clone());
        let begun = self
            .request(query)
            .and_then(|request| self.begin_fork(swarm, &key, &promise, &request));
        if let Err(error) = begun {
            let step = self.host.find(swarm).and_then(|handle| handle.step());
            promise.refuse(&error, step);
        }
    }

    fn begin_fork(
        &self,
        swarm: &Arc<str>,
        key: &str,
        promise: &Promise,
        request: &Request,
    ) -> Result<(), CommandError> {
        refuse_when(request)?;
        commands::sender("fork", request)?;
        let args: ForkArgs = request.args()?;
        check_name("name", &args.name)?;
        let Some(handle) = self.host.find(swarm) else {
            return Err(CommandError::UnknownSwarm(swarm.to_string()));
        };
        let now = handle.step().unwrap_or_default();
        if let Some(step) = args.step
            && jostle_convert::value::whole("step", step)? > now
        {
            return Err(CommandError::NotReached { step, now });
        }
        let timeout = commands::timeout(request)?;
        if !self.enter(key, request, promise)? {
            promise.keep_within(timeout, CommandError::deadline, || None);
            return Ok(());
        }
        promise.keep_within(timeout, CommandError::deadline, || None);
        let copy = Copy {
            host: self.host.clone(),
            keeper: Keeper::new(promise.clone()),
            register: self.registration(&args.name, key, request),
            name: args.name,
            reason: PauseReason::Forked,
        };
        match args.step {
            Some(step) => {
                let (store, swarm) = (self.store.clone(), swarm.clone());
                let told = thread::Builder::new()
                    .name("fork".into())
                    .spawn(move || {
                        copy.of(recovery::told_again(&store, &swarm, To::Step(step), |_| {}));
                    })
                    .map(drop);
                told.map_err(|_| CommandError::Busy)?;
            }
            None => handle.send(Ticket::Copy(Box::new(move |answered| match answered {
                Ok((_, Outcome::Whole(checkpoint))) => copy.make(*checkpoint),
                Ok(_) => copy.keeper.0.refuse(&CommandError::Internal, None),
                Err(Refusal { step, error }) => copy.keeper.0.refuse(&error.into(), step),
            }))),
        }
        Ok(())
    }

    /// Makes a swarm from a snapshot.
    pub(crate) fn restore(&self, promise: &Promise, request: &Request) -> Result<(), CommandError> {
        refuse_when(request)?;
        commands::sender("restore", request)?;
        let args: RestoreArgs = request.args()?;
        check_name("name", &args.name)?;
        let checkpoint = STANDARD
            .decode(args.snapshot.as_bytes())
            .map_err(|error| error.to_string())
            .and_then(|bytes| recovery::read_snapshot(&bytes))
            .and_then(|it| match sanity::check(&it) {
                Ok(()) => Ok(it),
                Err(error) => Err(error.to_string()),
            })
            .map_err(CommandError::Snapshot)?;
        // As it is, and as it would be when reset.
        let n = checkpoint
            .simulation
            .state
            .configuration
            .n()
            .max(checkpoint.simulation.spec.n);
        let limit = self.host.limits().max_individuals;
        if n > limit {
            return Err(OrderError::from(ReserveError::TooMany { n, limit }).into());
        }
        let timeout = commands::timeout(request)?;
        let key = keys::node_cmd(&self.prefix, &self.node, "restore");
        let is_new = self.enter(&key, request, promise)?;
        promise.keep_within(timeout, CommandError::deadline, || None);
        if is_new {
            let copy = Copy {
                host: self.host.clone(),
                keeper: Keeper::new(promise.clone()),
                register: self.registration(&args.name, &key, request),
                name: args.name,
                reason: PauseReason::Restored,
            };
            copy.make(checkpoint);
        }
        Ok(())
    }

    /// Answers with all that a swarm's future depends on.
    pub(crate) fn snapshot(&self, swarm: &Arc<str>, promise: &Promise, query: &Query) {
        if let Err(error) = selector(query.parameters().iter(), &[]) {
            return promise.refuse(&error, None);
        }
        let Some(handle) = self.host.find(swarm) else {
            return promise.refuse(&CommandError::UnknownSwarm(swarm.to_string()), None);
        };
        let late = handle.step_later();
        promise.keep_within(DEFAULT_TIMEOUT, CommandError::deadline, late);
        // What a daemon gives, a daemon with the same limits takes: in base64, with a name.
        let most_bytes = self.most_bytes() / 4 * 3 - BYTES_AROUND_SNAPSHOT;
        let (name, keeper) = (swarm.clone(), Keeper::new(promise.clone()));
        handle.send(Ticket::Copy(Box::new(move |answered| match answered {
            Ok((place, outcome)) => keeper.0.keep(move || {
                let payload = convert::outcome(&name, &place, outcome, None);
                let bytes = payload.bytes.len();
                if bytes > most_bytes {
                    let error = CommandError::SnapshotTooLong { bytes, most_bytes };
                    return Err(Payload::json(&error.to_wire(Some(place.step))));
                }
                Ok(payload)
            }),
            Err(Refusal { step, error }) => keeper.0.refuse(&error.into(), step),
        })));
    }

    /// Tells a swarm's history again and says whether it comes out the same.
    pub(crate) fn verify(&self, swarm: &Arc<str>, promise: &Promise, query: &Query) {
        if let Err(error) = selector(query.parameters().iter(), &[]) {
            return promise.refuse(&error, None);
        }
        let Some(handle) = self.host.find(swarm) else {
            return promise.refuse(&CommandError::UnknownSwarm(swarm.to_string()), None);
        };
        if handle.summary().is_some_and(|it| it.is_replay) {
            return promise.refuse(&OrderError::Recorded.into(), handle.step());
        }
        promise.keep_within(PATIENCE_WITH_HISTORY, CommandError::deadline, || None);
        let (store, name, keeper) = (
            self.store.clone(),
            swarm.clone(),
            Keeper::new(promise.clone()),
        );
        let here = handle.step();
        let begun = self.verifications.begin(
            swarm,
            Box::new(move |verification| {
                // Its deadline may have passed while it was queued.
                if keeper.0.is_kept() {
                    return;
                }
                let seen = present(&handle);
                let to = match &seen {
                    Some((place, _)) if !place.phase.is_moving() => {
                        To::Place(place.epoch, place.step)
                    }
                    _ => To::LastHash,
                };
                let progress = verification.clone();
                let told =
                    recovery::told_again(&store, &name, to, move |share| progress.advance(share));
                drop(verification);
                match told {
                    Ok(told) => {
                        let verified = verified(&told, seen);
                        handle.send(Ticket::Look(Box::new(move |answered| match answered {
                            Ok((place, _)) => keeper.0.keep(move || {
                                Ok(Payload::json(&convert::reply(&name, &place, verified)))
                            }),
                            Err(Refusal { step, error }) => {
                                keeper.0.refuse(&error.into(), step);
                            }
                        })));
                    }
                    Err(error) => keeper.0.refuse(&error, handle.step()),
                }
            }),
        );
        if let Err(work) = begun {
            promise.refuse(&CommandError::Busy, here);
            // It holds the keeper, which would refuse otherwise.
            drop(work);
        }
    }

    /// What makes a copy safe together with its answer.
    fn registration(
        &self,
        name: &str,
        key: &str,
        request: &Request,
    ) -> impl FnOnce(&Checkpoint) -> Register + Send + 'static {
        let (store, name) = (self.store.clone(), name.to_owned());
        let named = writer::named(key, request);
        move |checkpoint| {
            let recipe = checkpoint.simulation.spec.clone();
            let named = named.map(|named| {
                let (name, recipe) = (name.clone(), recipe.clone());
                let payload: MakePayload = Box::new(move |place, frame| {
                    convert::created(&name, place, &recipe, frame, true)
                });
                (named, payload)
            });
            writer::register(&store, &name, &recipe, named)
        }
    }
}

/// Where a swarm is now, and its hash.
fn present(handle: &Handle) -> Option<(Place, [u8; 32])> {
    let (answer, answered) = sync_channel(1);
    handle.send(Ticket::Look(Box::new(move |seen| drop(answer.send(seen)))));
    match answered.recv() {
        Ok(Ok((place, Outcome::Seen(frame)))) => Some((place, frame.hash?)),
        _ => None,
    }
}

/// Whether what was told again has the hash that its swarm has; none if it is not where that is.
fn is_as_now(told: &Retold, place: &Place, hash: [u8; 32]) -> Option<bool> {
    let checkpoint = &told.checkpoint;
    let told_to = (
        checkpoint.simulation.epoch,
        checkpoint.simulation.state.step,
        checkpoint.simulation.seq,
    );
    let is_there = told_to == (place.epoch, place.step, place.seq);
    is_there.then(|| checkpoint.simulation.state.hash() == hash)
}

/// What a history that was told again says, beside where its swarm was then and its hash.
fn verified(told: &Retold, seen: Option<(Place, [u8; 32])>) -> Verified {
    let now = seen.and_then(|(place, hash)| is_as_now(told, &place, hash));
    let here = (
        told.checkpoint.simulation.epoch,
        told.checkpoint.simulation.state.step,
    );
    let differs_at = told.differs_at.or((now == Some(false)).then_some(here));
    Verified {
        from_step: told.from,
        to_step: here.1,
        hashes: told.same + u64::from(told.differs_at.is_some()) + u64::from(now.is_some()),
        differs_at: differs_at.map(|(_, step)| step),
        differs_in_epoch: differs_at.map(|(epoch, _)| epoch),
    }
}

/// A copy that is to be made.
struct Copy<R> {
    host: Arc<Host>,
    keeper: Keeper,
    register: R,
    name: String,
    reason: PauseReason,
}

impl<R: FnOnce(&Checkpoint) -> Register> Copy<R> {
    /// Makes it as what was told again.
    fn of(self, told: Result<Retold, CommandError>) {
        match told {
            Ok(told) => self.make(told.checkpoint),
            Err(error) => self.keeper.0.refuse(&error, None),
        }
    }

    fn make(self, checkpoint: Checkpoint) {
        let Copy {
            host,
            keeper,
            register,
            name,
            reason,
        } = self;
        let checkpoint = checkpoint.for_another(Phase::Paused(reason));
        let recipe = checkpoint.simulation.spec.clone();
        let register = register(&checkpoint);
        let promise = keeper.leave();
        let answer = {
            let (promise, name) = (promise.clone(), name.clone());
            move || -> Answer {
                let keeper = Keeper::new(promise);
                Box::new(move |answered| match answered {
                    Ok((place, Outcome::Seen(seen))) => keeper
                        .0
                        .fulfil(move || Ok(convert::created(&name, &place, &recipe, &seen, true))),
                    Ok(_) => keeper.0.refuse(&CommandError::Internal, None),
                    Err(Refusal { step, error }) => keeper.0.refuse(&error.into(), step),
                })
            }
        };
        if let Err(error) = host.copy(&name, checkpoint, register, answer) {
            promise.refuse(&error.into(), None);
        }
    }
}

/// What is made anew has no step at which it could be made.
pub(crate) fn refuse_when(request: &Request) -> Result<(), CommandError> {
    for (field, given) in [
        ("at_step", request.at_step),
        ("expect_step", request.expect_step),
        ("expect_epoch", request.expect_epoch),
    ] {
        if given.is_some() {
            let problem = "is about a swarm that is there: leave it out";
            return Err(CommandError::Field { field, problem });
        }
    }
    Ok(())
}
