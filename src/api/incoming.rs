//! Requests as a transport received them.

use std::ops::Deref;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use jostle_proto::Request;
use jostle_proto::contract::selectors::{
    self, MAX_PAGE_ENTRIES, MAX_RUN_ENTRIES, PAGE_ENTRIES, QueryParameter,
};
use jostle_proto::verbs::journaled;

use crate::api::admission::{HeldBytes, Permit, Places};
use crate::convert::Payload;
use crate::convert::commands::{selector, truncate};
use crate::convert::error::CommandError;
use crate::persistence::journal_page::JournalFilter;
use crate::store::AuditFilter;
use crate::swarm::awaited::Holder;

/// Encodings in which requests are read; no encoding is JSON.
const JSON_ENCODINGS: [&str; 5] = [
    "application/json",
    "text/json",
    "text/plain",
    "zenoh/string",
    "zenoh/bytes",
];

/// The latest time of a selector: the end of the year 9999.
const MAX_UNIX_SECS: f64 = 253_402_300_800.0;

/// The connection to the client that sent a request.
pub trait Peer: Send + Sync {
    /// Sends a reply under `key`. It may block while the client accepts nothing.
    fn reply(&self, key: &str, reply: Result<Payload, Payload>);

    /// Whether the client is known to wait no longer.
    fn is_gone(&self) -> bool {
        false
    }

    /// The HTTP connection of the client and the name of the request, if it came over HTTP.
    fn connection(&self) -> Option<(Arc<Holder>, String)> {
        None
    }

    /// Whether the key expression of the request matches `key`.
    fn matches(&self, key: &str) -> bool;
}

/// What a key addresses.
#[derive(Clone, Debug)]
pub enum Target {
    /// The `state` of a swarm.
    State(Arc<str>),
    /// `get/**` of a swarm.
    Get(Arc<str>),
    /// `cmd/**` of a swarm.
    Command(Arc<str>),
    /// `cmd/delete` of any swarm, also of one that no longer exists.
    Deletion,
    /// `get/**` of the daemon.
    NodeGet,
    /// `cmd/**` of the daemon.
    NodeCommand,
    /// `experiment/**` of the daemon.
    Experiment,
}

/// A request. Clones are the same request; each may be replied to under another key.
#[derive(Clone)]
pub struct Incoming {
    received: Arc<Received>,
    /// Whether a responder replies to it.
    pub(super) has_responder: Arc<AtomicBool>,
    _places: Option<Arc<Places>>,
    _bytes: Arc<HeldBytes>,
}

impl Deref for Incoming {
    type Target = Received;

    fn deref(&self) -> &Received {
        &self.received
    }
}

/// The parts of a request.
pub struct Received {
    /// What its key addresses.
    pub target: Target,
    /// The key expression.
    pub key: String,
    /// Whether the key expression contains a wildcard.
    pub is_wild: bool,
    /// The parameters of the selector.
    pub parameters: Vec<(String, String)>,
    /// The payload; empty if there is none.
    pub payload: Vec<u8>,
    /// The encoding of the payload, if there is one.
    pub encoding: Option<String>,
    /// The client's token; empty if there is none.
    pub token: Vec<u8>,
    /// Where replies go.
    pub peer: Box<dyn Peer>,
}

impl Incoming {
    /// A request that was admitted with `permit`.
    pub fn new(received: Received, permit: Permit) -> Self {
        Incoming {
            received: Arc::new(received),
            has_responder: Arc::default(),
            _places: Some(Arc::new(permit.places)),
            _bytes: Arc::new(permit.bytes),
        }
    }

    /// The same request without a place among the unanswered ones: while it waits for a condition, it
    /// does not count against the limit of its queryable.
    #[must_use]
    pub fn without_places(&self) -> Incoming {
        Incoming {
            _places: None,
            ..self.clone()
        }
    }

    /// The verb of a command; the whole key if there is none.
    pub fn verb(&self) -> String {
        let key = self.key.as_str();
        truncate(key.split_once("/cmd/").map_or(key, |(_, verb)| verb))
    }

    /// The parameters of the selector.
    pub fn parameters(&self) -> impl Iterator<Item = (&str, &str)> {
        let parameters = self.parameters.iter();
        parameters.map(|(name, value)| (name.as_str(), value.as_str()))
    }

    /// Rejects parameters, except those of zenoh, which begin with `_`.
    ///
    /// # Errors
    ///
    /// [`CommandError::Parameter`].
    pub fn no_parameters(&self) -> Result<(), CommandError> {
        selector(self.parameters(), &[]).map(drop)
    }

    /// Whether a query of states requests JSON.
    ///
    /// # Errors
    ///
    /// [`CommandError::Field`] for an unknown format, [`CommandError::Parameter`].
    pub fn wants_json(&self) -> Result<bool, CommandError> {
        match selector(self.parameters(), selectors::STATE)?.first() {
            None | Some((_, "cbor")) => Ok(false),
            Some((_, "json")) => Ok(true),
            Some(_) => Err(CommandError::Field {
                field: "format",
                problem: "is not json or cbor",
            }),
        }
    }

    /// Parses the payload, of at most `max_bytes`.
    ///
    /// # Errors
    ///
    /// [`CommandError::TooLong`], [`CommandError::Encoding`], [`CommandError::Request`] and
    /// [`CommandError::Parameter`].
    pub fn request(&self, max_bytes: usize) -> Result<Request, CommandError> {
        self.no_parameters()?;
        let bytes = self.payload.len();
        if bytes > max_bytes {
            return Err(CommandError::TooLong { bytes, max_bytes });
        }
        if let Some(encoding) = &self.encoding
            && !JSON_ENCODINGS.contains(&encoding.as_str())
        {
            return Err(CommandError::Encoding(truncate(encoding)));
        }
        Ok(Request::from_json(&self.payload)?)
    }
}

/// The number after which a page of records begins, and the most records, from the parameters of a
/// selector.
///
/// # Errors
///
/// [`CommandError::Parameter`], [`CommandError::Twice`] and [`CommandError::Field`].
pub fn page<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<(u64, usize), CommandError> {
    let (_, after, limit) = page_of(parameters, selectors::PAGE, PAGE_ENTRIES, MAX_PAGE_ENTRIES)?;
    Ok((after, limit))
}

/// A page of a journal, from the parameters of a selector.
///
/// # Errors
///
/// As those of [`page`].
pub(super) fn page_of_journal<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<JournalFilter, CommandError> {
    let known = selectors::PAGE_OF_JOURNAL;
    let mut filter = JournalFilter::default();
    let mut rest = Vec::new();
    for (name, value) in selector(parameters, known)? {
        let number = |field| whole(field, value).map(Some);
        match name {
            "line" => filter.line = number("line")?,
            "from_step" => filter.from_step = number("from_step")?,
            "to_step" => filter.to_step = number("to_step")?,
            "verb" => {
                if journaled(value).is_none() {
                    return Err(CommandError::Field {
                        field: "verb",
                        problem: "is no verb of a swarm",
                    });
                }
                filter.verb = Some(value.to_owned());
            }
            "client" => filter.client = Some(value.to_owned()),
            _ => rest.push((name, value)),
        }
    }
    if let (Some(from), Some(to)) = (filter.from_step, filter.to_step)
        && from > to
    {
        return Err(CommandError::Field {
            field: "to_step",
            problem: "is less than from_step",
        });
    }
    let (_, after, limit) = page_of(rest.into_iter(), known, PAGE_ENTRIES, MAX_PAGE_ENTRIES)?;
    Ok(JournalFilter {
        after,
        limit,
        ..filter
    })
}

fn whole(field: &'static str, value: &str) -> Result<u64, CommandError> {
    value.parse().map_err(|_| CommandError::Unreadable {
        field,
        expected: "a whole number, 0 or more",
    })
}

/// A page of the audit log, from the parameters of a selector.
///
/// # Errors
///
/// As those of [`page`].
pub(super) fn page_of_audit<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<AuditFilter, CommandError> {
    let known = selectors::PAGE_OF_AUDIT;
    let mut filter = AuditFilter::default();
    let mut rest = Vec::new();
    for (name, value) in selector(parameters, known)? {
        let text = || Some(value.to_owned());
        match name {
            "before" => filter.before = Some(whole("before", value)?),
            "user" => filter.user = text(),
            "client" => filter.client = text(),
            "verb" => filter.verb = text(),
            "name" => filter.name = text(),
            "from_time" => filter.from_ms = Some(milliseconds("from_time", value)?),
            "to_time" => filter.to_ms = Some(milliseconds("to_time", value)?),
            _ => rest.push((name, value)),
        }
    }
    let (_, after, limit) = page_of(rest.into_iter(), known, PAGE_ENTRIES, MAX_PAGE_ENTRIES)?;
    Ok(AuditFilter {
        after,
        limit,
        ..filter
    })
}

/// The milliseconds since 1970 of a time in seconds.
fn milliseconds(field: &'static str, value: &str) -> Result<u64, CommandError> {
    let secs: Option<f64> = value.parse().ok();
    let secs = secs.filter(|secs| (0.0..=MAX_UNIX_SECS).contains(secs));
    let time = secs.and_then(|secs| Duration::try_from_secs_f64(secs).ok());
    // To the nearest: no double is most milliseconds.
    let ms = time.and_then(|time| u64::try_from((time.as_micros() + 500) / 1000).ok());
    ms.ok_or(CommandError::Unreadable {
        field,
        expected: "a time in seconds since 1970",
    })
}

/// The run of an experiment, and a page of of its records.
pub(super) fn page_of_run<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<(&'a str, u64, usize), CommandError> {
    let (known, max) = (selectors::PAGE_OF_RUN, MAX_RUN_ENTRIES);
    let (run, after, limit) = page_of(parameters, known, max, max)?;
    Ok((required(run)?, after, limit))
}

/// As [`page_of_run`], and whether the records are those of individuals.
pub(super) fn page_of_series<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
) -> Result<((&'a str, u64, usize), bool), CommandError> {
    let (known, max) = (selectors::PAGE_OF_SERIES, MAX_RUN_ENTRIES);
    let mut of = None;
    // An unknown parameter is rejected below.
    let rest: Vec<_> = parameters.collect();
    selector(rest.iter().copied(), known)?;
    let rest = rest.into_iter().filter(|(name, value)| {
        let is_rest = *name != "of";
        of = of.or((!is_rest).then_some(*value));
        is_rest
    });
    let (run, after, limit) = page_of(rest, known, max, max)?;
    let is_trajectory = match of {
        None => false,
        Some("individuals") => true,
        Some(_) => {
            return Err(CommandError::Field {
                field: "of",
                problem: "is not individuals: leave it out for measures",
            });
        }
    };
    Ok(((required(run)?, after, limit), is_trajectory))
}

fn required(run: Option<&str>) -> Result<&str, CommandError> {
    run.ok_or(CommandError::Field {
        field: "run",
        problem: "is missing: give a run as the results name it",
    })
}

fn page_of<'a>(
    parameters: impl Iterator<Item = (&'a str, &'a str)>,
    known: &'static [QueryParameter],
    mut limit: usize,
    max: usize,
) -> Result<(Option<&'a str>, u64, usize), CommandError> {
    let (mut run, mut after) = (None, 0);
    for (name, value) in selector(parameters, known)? {
        match name {
            "run" => run = Some(value),
            "after" => after = whole("after", value)?,
            _ => {
                let number = value.parse().ok();
                let number = number.filter(|number| (1..=max).contains(number));
                limit = number.ok_or(CommandError::PageLimit { max })?;
            }
        }
    }
    Ok((run, after, limit))
}

#[cfg(test)]
pub(super) mod fixture {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use std::sync::mpsc::{Receiver, Sender, channel};

    use serde_json::Value;

    use super::*;
    use crate::api::admission::{Admission, Unanswered};

    pub(crate) const LONG: Duration = Duration::from_secs(20);

    /// The replies that a client received.
    pub(crate) type Sent = Receiver<Result<Payload, Payload>>;

    struct Client(Sender<Result<Payload, Payload>>);

    impl Peer for Client {
        fn reply(&self, _: &str, reply: Result<Payload, Payload>) {
            self.0.send(reply).unwrap();
        }

        fn matches(&self, _: &str) -> bool {
            false
        }
    }

    /// A request, and the replies to it.
    pub(crate) fn request(is_wild: bool) -> (Incoming, Sent) {
        let (sender, replies) = channel();
        let received = Received {
            target: Target::NodeGet,
            key: "jostle/ants/cmd/step".to_owned(),
            is_wild,
            parameters: Vec::new(),
            payload: Vec::new(),
            encoding: None,
            token: Vec::new(),
            peer: Box::new(Client(sender)),
        };
        let permit = Admission::default()
            .admit(0, &None, &Unanswered::default())
            .unwrap();
        (Incoming::new(received, permit), replies)
    }

    /// The code of an error.
    pub(crate) fn code(reply: Result<Payload, Payload>) -> String {
        let error: Value = serde_json::from_slice(&reply.unwrap_err().bytes).unwrap();
        error["code"].as_str().unwrap().to_owned()
    }
}
