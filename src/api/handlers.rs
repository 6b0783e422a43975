//! What changes something: commands to swarms, and to the daemon.

use std::sync::Arc;

use jostle_proto::verbs::{CreateArgs, DiscardArgs};
use jostle_proto::{Request, keys};

use crate::api::commands::{self, Command, CommandError, check_name, create};
use crate::api::context::Clerk;
use crate::api::copies::refuse_when;
use crate::api::idempotency::Entered;
use crate::api::responder::{Asked, Keeper, Promise};
use crate::convert;
use crate::persistence::writer::{self, MakePayload};
use crate::swarm::handle::{self, Ticket};
use crate::swarm::outcome::{Answer, Outcome, Refusal};
use crate::swarm::registry::Created;
use crate::transport::zenoh::dispatcher::Dispatcher;
use crate::transport::zenoh::query::token;
use crate::transport::zenoh::session::MAX_MESSAGE_BYTES;

/// The longest request that says nothing of every individual, in bytes.
const BYTES_OF_REQUEST: usize = 64 * 1024;

/// The longest that a request says of an individual, in bytes: where it is, or in a snapshot all
/// that there is to it, its contacts too.
const BYTES_PER_INDIVIDUAL: usize = 256;

/// The longest request of all: what zenoh lets through, less its own framing.
const MOST_BYTES: usize = MAX_MESSAGE_BYTES - 4096;

impl Clerk {
    /// Executes only what its own key names: a wildcard changes nothing.
    pub(crate) fn command(&self, swarm: &Arc<str>, asked: &Asked) {
        let query = &asked.query;
        let key = query.key_expr().as_str();
        let verb = key.strip_prefix(&keys::cmd(&self.prefix, swarm, ""));
        match verb {
            Some("fork") => return self.fork(swarm, asked),
            Some("seek") => return self.seek(swarm, asked),
            _ => {}
        }
        let promise = self.desk.promise(asked, key.to_owned());
        let read = if query.key_expr().is_wild() {
            Err(CommandError::Wildcard)
        } else {
            let verb = verb.unwrap_or_default();
            self.request(query).and_then(|request| {
                let mut command = commands::read(verb, &request)?;
                if let Some(controller) = command.order.controller()
                    && let rights = self.rights.current()
                    && let Some(person) = rights.sender(&token(query), verb)?
                {
                    person.permit_controller(controller)?;
                }
                if let Some(named) = writer::named(key, &request)
                    && let Some(sender) = Arc::get_mut(&mut command.sender)
                {
                    sender.digest = Some(named.digest);
                }
                let is_new = self.enter(key, &request, &promise)?;
                Ok((command, is_new))
            })
        };
        let (command, is_new) = match read {
            Ok(command) => command,
            Err(error) => {
                let step = self.host.find(swarm).and_then(|handle| handle.step());
                return promise.refuse(&error, step);
            }
        };
        let Command {
            order,
            when,
            sender,
            timeout,
            returns_state,
        } = command;
        if !is_new {
            let late = self.host.find(swarm).map(|handle| handle.step_later());
            return promise.keep_within(timeout, CommandError::deadline, move || late?());
        }
        let (press, name) = (self.press.clone(), swarm.clone());
        self.send(
            swarm,
            &promise,
            (timeout, CommandError::deadline),
            |answer| {
                Ticket::Command(handle::Command {
                    order,
                    when,
                    sender,
                    answer: Box::new(move |answered| {
                        answer(answered, move |place, outcome| {
                            let frame = returns_state.then(|| {
                                press
                                    .find(&name)
                                    .map_or(0, |publication| publication.frames())
                            });
                            convert::outcome(&name, &place, outcome, frame)
                        });
                    }),
                })
            },
        );
    }

    pub(crate) fn node_command(&self, asked: &Asked) {
        let query = &asked.query;
        let promise = self
            .desk
            .promise(asked, query.key_expr().as_str().to_owned());
        if query.key_expr().is_wild() {
            return promise.refuse(&CommandError::Wildcard, None);
        }
        let verb =
            query
                .key_expr()
                .as_str()
                .strip_prefix(&keys::node_cmd(&self.prefix, &self.node, ""));
        let done = match verb {
            Some("create") => self
                .request(query)
                .and_then(|request| self.create(&promise, &request)),
            Some("restore") => self
                .request(query)
                .and_then(|request| self.restore(&promise, &request)),
            Some("discard") => self
                .request(query)
                .and_then(|request| self.discard(&promise, &request)),
            Some("experiment") => self
                .request(query)
                .and_then(|request| self.experiment(&promise, &request)),
            Some("replay") => self
                .request(query)
                .and_then(|request| self.replay(&promise, &request)),
            Some("record") => self
                .request(query)
                .and_then(|request| self.record(&promise, &request)),
            verb => Err(CommandError::UnknownVerb {
                verb: commands::shortened(verb.unwrap_or_default()),
                known: &keys::NODE_VERBS,
            }),
        };
        if let Err(error) = done {
            promise.refuse(&error, None);
        }
    }

    fn create(&self, promise: &Promise, request: &Request) -> Result<(), CommandError> {
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
        commands::sender("create", request)?;
        let args: CreateArgs = request.args()?;
        let recipe = create::recipe(&args, self.host.limits())?;
        let timeout = commands::timeout(request)?;
        let key = keys::node_cmd(&self.prefix, &self.node, "create");
        let is_new = self.enter(&key, request, promise)?;
        promise.keep_within(timeout, CommandError::deadline, || None);
        if !is_new {
            return Ok(());
        }
        let name = args.name;
        let answer = |created: bool| -> Answer {
            let (keeper, name, recipe) =
                (Keeper::new(promise.clone()), name.clone(), recipe.clone());
            Box::new(move |answered| match answered {
                Ok((place, Outcome::Seen(seen))) => keeper
                    .0
                    .fulfil(move || Ok(convert::created(&name, &place, &recipe, &seen, created))),
                Ok((place, other)) => keeper
                    .0
                    .fulfil(move || Ok(convert::outcome(&name, &place, other, None))),
                Err(Refusal { step, error }) => {
                    keeper.0.refuse(&create::explain(error), step);
                }
            })
        };
        let named = writer::named(&key, request).map(|named| {
            let (name, recipe) = (name.clone(), recipe.clone());
            let payload: MakePayload =
                Box::new(move |place, frame| convert::created(&name, place, &recipe, frame, true));
            (named, payload)
        });
        let register = writer::register(&self.store, &name, &recipe, named);
        let recipe_ = recipe.clone();
        let created = self
            .host
            .create(&name, recipe_, args.exist_ok, register, || answer(true))?;
        if let Created::Existing(handle) = created {
            handle.send(Ticket::Look(answer(false)));
        }
        Ok(())
    }

    /// Deletes this daemon's swarm of a name that other daemons may hold, too.
    fn discard(&self, promise: &Promise, request: &Request) -> Result<(), CommandError> {
        refuse_when(request)?;
        let DiscardArgs { name } = request.args()?;
        check_name("name", &name)?;
        let Command {
            order,
            when,
            sender,
            timeout,
            ..
        } = commands::read(
            "delete",
            &Request {
                request_id: request.request_id.clone(),
                client: request.client.clone(),
                timeout_secs: request.timeout_secs,
                ..Request::default()
            },
        )?;
        let key = keys::node_cmd(&self.prefix, &self.node, "discard");
        if !self.enter(&key, request, promise)? {
            promise.keep_within(timeout, CommandError::deadline, || None);
            return Ok(());
        }
        let swarm = name.clone();
        let patience = (timeout, CommandError::deadline as fn(f64) -> CommandError);
        self.send(&swarm, promise, patience, |answer| {
            Ticket::Command(handle::Command {
                order,
                when,
                sender,
                answer: Box::new(move |answered| {
                    answer(answered, move |place, outcome| {
                        convert::outcome(&name, &place, outcome, None)
                    });
                }),
            })
        });
        Ok(())
    }

    /// Enters a request that has a name into the ledger; false if it need not be carried out.
    pub(crate) fn enter(
        &self,
        key: &str,
        request: &Request,
        promise: &Promise,
    ) -> Result<bool, CommandError> {
        let Some(id) = &request.request_id else {
            return Ok(true);
        };
        match self.ledger.enter(key, request, id, promise) {
            Entered::New(page) => {
                promise.note_on(page);
                Ok(true)
            }
            Entered::Known => Ok(false),
            Entered::Other => Err(CommandError::OtherRequest(id.clone())),
        }
    }

    /// The longest request that is read. One that is a little longer is refused by name; only what
    /// zenoh does not let through is lost without a word.
    pub(crate) fn most_bytes(&self) -> usize {
        let everybody = BYTES_PER_INDIVIDUAL.saturating_mul(self.host.limits().max_individuals);
        everybody.saturating_add(BYTES_OF_REQUEST).min(MOST_BYTES)
    }
}

impl Dispatcher {
    /// Answers whoever deleted a swarm and asks again, when nothing of it is there to answer. Others
    /// are left to whoever has that swarm.
    pub(crate) fn deleted(&self, asked: &Asked) {
        let query = &asked.query;
        let key = query.key_expr().as_str();
        let swarm = key
            .strip_prefix(&self.clerk.prefix)
            .and_then(|key| key.strip_prefix('/')?.strip_suffix("/cmd/delete"));
        if query.key_expr().is_wild() || swarm.is_none_or(|swarm| self.doors.has(swarm)) {
            return;
        }
        if self.clerk.permit(query).is_ok()
            && let Ok(request) = self.clerk.request(query)
            && let Some(id) = &request.request_id
        {
            let promise = self.clerk.desk.promise(asked, key.to_owned());
            self.clerk.ledger.tell(key, &request, id, &promise);
        }
    }
}
