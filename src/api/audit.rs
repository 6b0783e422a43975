//! Which requests are in the audit log, and as what.

use std::collections::BTreeMap;

use jostle_proto::{Request, keys};
use serde::Deserialize;
use serde_json::value::RawValue;

use crate::api::context::Context;
use crate::api::incoming::Incoming;
use crate::api::responder::Responder;
use crate::audit::AuditCommand;
use crate::auth::{Rights, split_signed};
use crate::convert::commands::truncate;

/// The longest request that is parsed although it is not permitted.
const MAX_PARSED: usize = 64 * 1024;

/// The code of an error.
const PERMISSION_DENIED: &str = "permission_denied";

/// The fields of arguments that say what a command concerns.
#[derive(Default, Deserialize)]
struct Named {
    name: Option<String>,
    recording: Option<String>,
    swarm: Option<String>,
    toml: Option<String>,
}

impl Context {
    /// Adds an accepted command to the audit log, to which `responder` adds its outcome.
    pub(super) fn audit(&self, key: &str, request: &Request, responder: &Responder) {
        let (user, client) = match (&*self.rights.current(), request.client.as_deref()) {
            (Rights::Open, client) => (None, client),
            (Rights::Users { .. }, Some(client)) => split_signed(client),
            (Rights::Users { .. }, None) => (None, None),
        };
        let command = self.audited(key, user, client, request.args.as_deref());
        responder.set_audit(self.audit.begin(command));
    }

    /// Adds a command that is not permitted to the audit log.
    pub(super) fn audit_denied(&self, incoming: &Incoming) {
        let rights = self.rights.current();
        let user = rights.owner(&incoming.token).map(|user| user.name.as_str());
        let is_short = incoming.payload.len() <= MAX_PARSED;
        let request = is_short.then(|| Request::from_json(&incoming.payload).ok());
        let request = request.flatten().unwrap_or_default();
        let client = request.client.as_deref();
        let command = self.audited(&incoming.key, user, client, request.args.as_deref());
        self.audit.begin(command).finish(PERMISSION_DENIED);
    }

    fn audited(
        &self,
        key: &str,
        user: Option<&str>,
        client: Option<&str>,
        args: Option<&RawValue>,
    ) -> AuditCommand {
        let begin = keys::cmd(&self.prefix, "", "");
        let begin = begin.strip_suffix("/cmd/").unwrap_or_default();
        let path = key.strip_prefix(begin).unwrap_or(key);
        let (about, verb) = path.split_once("/cmd/").unwrap_or(("", path));
        let swarm = (!about.starts_with("@node/")).then_some(about);
        let (action, name) = subject(verb, swarm, args);
        AuditCommand {
            user: user.map(str::to_owned),
            client: client.map(truncate),
            verb: truncate(verb),
            action: action.as_deref().map(truncate),
            name: name.as_deref().map(truncate),
        }
    }
}

/// What a command does, for verbs that do several things, and the name of what it concerns.
fn subject(
    verb: &str,
    swarm: Option<&str>,
    args: Option<&RawValue>,
) -> (Option<String>, Option<String>) {
    let text = args.map_or("{}", RawValue::get);
    let named = |text: &str| serde_json::from_str::<Named>(text).unwrap_or_default();
    match (verb, swarm) {
        ("fork", Some(swarm)) => (Some(format!("of {swarm}")), named(text).name),
        (_, Some(swarm)) => (None, Some(swarm.to_owned())),
        ("experiment" | "record" | "replay", None) => {
            let actions = serde_json::from_str::<BTreeMap<String, Box<RawValue>>>(text);
            let Some((action, args)) = actions.ok().and_then(|mut it| it.pop_first()) else {
                return (None, None);
            };
            let Named {
                name,
                recording,
                swarm,
                toml,
            } = named(args.get());
            let in_file = || toml::from_str::<Named>(&toml?).ok()?.name;
            (Some(action), name.or(recording).or(swarm).or_else(in_file))
        }
        _ => (None, named(text).name),
    }
}
