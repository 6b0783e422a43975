//! What is checked, and how; nothing here changes anything.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use jostle_proto::{
    ErrorCode, Hello, Metrics, NodeReply, NodeStatus, Phase, RecordingMetrics, SwarmSummary,
    Swarms, WIRE_VERSION, keys,
};
use serde_json::json;

use super::report::Check;
use crate::bus::{Answer, Bus, Samples, Whom};
use crate::failure::Failure;
use crate::format;

/// A verb that there will never be: the answer that it is unknown shows that verbs arrive.
pub const UNKNOWN_VERB: &str = "no-such-verb-of-the-doctor";
/// How often the daemon is asked to find out how long an answer takes.
const QUESTIONS: usize = 20;
/// How far clocks may differ before times on two machines are misleading.
const CLOCK_TOLERANCE_SECS: f64 = 1.0;
/// How long an answer may take.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long something published is waited for: each swarm says something every two seconds.
const LISTENING: Duration = Duration::from_secs(5);

/// When a question was asked and answered.
#[derive(Clone, Copy)]
pub struct Asked {
    /// The middle between the two, in seconds since 1970.
    unix_secs: f64,
    /// The time between the two.
    took: Duration,
}

/// The daemon to examine: the one named or the only one, even if its token is not seen.
///
/// # Errors
///
/// That there is none, or several.
pub async fn find_node(bus: &Bus, presence: &[String]) -> Result<String, Failure> {
    let failure = match bus.node().await {
        Ok(node) if presence.is_empty() || presence.contains(&node) => return Ok(node),
        Ok(node) => Failure::UnknownNode {
            node,
            there: presence.to_vec(),
        },
        Err(failure) => failure,
    };
    if !presence.is_empty() {
        return Err(failure);
    }
    // Tokens may be forbidden where questions are not.
    let hello = keys::node_get(bus.prefix(), "*", "hello");
    let answer = bus.ask(Whom::Node("*"), &hello, None, PATIENCE).await;
    match answer.and_then(|answer| answer.read::<NodeReply<Hello>>()) {
        Ok(reply) => Ok(reply.node),
        Err(_) => Err(failure),
    }
}

/// What the daemon says about itself, and when it said so.
///
/// # Errors
///
/// Why it says nothing.
pub async fn hello(bus: &Bus, node: &str) -> Result<(Hello, Asked), Failure> {
    let (before, began) = (unix_secs(), Instant::now());
    let reply: NodeReply<Hello> = get_node(bus, node, "hello").await?.read()?;
    let took = began.elapsed();
    let asked = Asked {
        unix_secs: before + took.as_secs_f64() / 2.0,
        took,
    };
    Ok((reply.result, asked))
}

/// Is the daemon there?
pub async fn daemon(bus: &Bus, node: &str, hello: &Result<(Hello, Asked), Failure>) -> Check {
    const NAME: &str = "daemon";
    if let Err(failure) = hello {
        return Check::failed(NAME, failure);
    }
    let status = match get_node(bus, node, "status").await {
        Ok(answer) => answer.read::<NodeReply<NodeStatus>>(),
        Err(failure) => Err(failure),
    };
    match status {
        Ok(reply) => {
            let status = reply.result;
            let up = format::duration(status.uptime_secs);
            let clients = format::count(status.clients, "client");
            Check::well(NAME, format!("node {node}, up for {up}, {clients}")).with(json!({
                "node": node,
                "uptime_secs": status.uptime_secs,
                "clients": status.clients,
            }))
        }
        Err(failure) => Check::failed(NAME, &failure),
    }
}

/// Do both speak the same contract?
pub fn versions(hello: &Hello) -> Check {
    const NAME: &str = "versions";
    let (theirs, ours) = (hello.wire_version, WIRE_VERSION);
    let said = format!(
        "the daemon is {} and speaks wire version {theirs}, this is {} and speaks {ours}",
        hello.version,
        env!("CARGO_PKG_VERSION"),
    );
    let check = if theirs == ours {
        Check::well(NAME, said)
    } else {
        let older = if theirs < ours {
            "daemon"
        } else {
            "command line"
        };
        let remedy = format!("bring the {older} up to date");
        Check::wrong(NAME, "internal", said, &remedy)
    };
    check.with(json!({"version": hello.version, "wire_version": theirs}))
}

/// Do the clocks agree, as far as the time the answer took allows to say?
pub fn clock(hello: &Hello, asked: Asked) -> Check {
    const NAME: &str = "clock";
    let difference = hello.unix_secs - asked.unix_secs;
    let direction = if difference < 0.0 {
        "behind"
    } else {
        "ahead of"
    };
    let said = format!(
        "the daemon's is {} {direction} this one, give or take {}",
        format::millis(difference.abs()),
        format::millis(asked.took.as_secs_f64() / 2.0),
    );
    let check = if difference.abs() <= CLOCK_TOLERANCE_SECS + asked.took.as_secs_f64() {
        Check::well(NAME, said)
    } else {
        let remedy = "let both machines set their clocks by NTP";
        Check::wrong(NAME, "internal", said, remedy)
    };
    check.with(json!({ "difference_secs": difference }))
}

/// How long does an answer take?
pub async fn latency(bus: &Bus, node: &str) -> Check {
    const NAME: &str = "latency";
    let mut took = Vec::with_capacity(QUESTIONS);
    for _ in 0..QUESTIONS {
        let began = Instant::now();
        if let Err(failure) = get_node(bus, node, "hello").await {
            return Check::failed(NAME, &failure);
        }
        took.push(began.elapsed().as_secs_f64());
    }
    took.sort_by(f64::total_cmp);
    let (least, median, most) = (took[0], took[QUESTIONS / 2], took[QUESTIONS - 1]);
    Check::well(
        NAME,
        format!(
            "an answer takes {} (median of {QUESTIONS}; {} to {})",
            format::millis(median),
            format::millis(least),
            format::millis(most),
        ),
    )
    .with(json!({
        "questions": QUESTIONS,
        "min_secs": least,
        "median_secs": median,
        "max_secs": most,
    }))
}

/// What is there?
pub async fn swarms(bus: &Bus, node: &str) -> (Check, Vec<SwarmSummary>) {
    const NAME: &str = "swarms";
    let reply = match get_node(bus, node, "swarms").await {
        Ok(answer) => answer.read::<NodeReply<Swarms>>(),
        Err(failure) => Err(failure),
    };
    let swarms = match reply {
        Ok(reply) => reply.result.swarms,
        Err(failure) => return (Check::failed(NAME, &failure), Vec::new()),
    };
    let in_phase = |phase| swarms.iter().filter(|swarm| swarm.phase == phase).count();
    let (running, faulted) = (in_phase(Phase::Running), in_phase(Phase::Faulted));
    let figures = json!({"swarms": swarms.len(), "running": running, "faulted": faulted});
    let said = match swarms.len() {
        0 => "none".into(),
        count => format!("{count}, of which {running} running and {faulted} faulted"),
    };
    (Check::well(NAME, said).with(figures), swarms)
}

/// The daemon in numbers.
///
/// # Errors
///
/// Why there are none.
pub async fn metrics(bus: &Bus, node: &str) -> Result<Metrics, Failure> {
    let reply: NodeReply<Metrics> = get_node(bus, node, "metrics").await?.read()?;
    Ok(reply.result)
}

/// Is the daemon itself well?
pub fn health(metrics: &Result<Metrics, Failure>) -> Check {
    const NAME: &str = "health";
    const REMEDY: &str = "see its log, and what docs/health.md says of /healthz";
    match metrics {
        Ok(metrics) if metrics.unwell.is_empty() => {
            let said = "its threads are at work and its disk takes what it writes";
            Check::well(NAME, said.into())
        }
        Ok(metrics) => Check::wrong(NAME, "unwell", metrics.unwell.join("; "), REMEDY),
        Err(failure) => Check::failed(NAME, failure),
    }
}

/// Has a recording of the daemon failed?
pub fn recordings(metrics: &Result<Metrics, Failure>) -> Check {
    const NAME: &str = "recordings";
    const REMEDY: &str =
        "copy what you need of recordings/NAME in its data directory before you delete one";
    let metrics = match metrics {
        Ok(metrics) => metrics,
        Err(failure) => return Check::failed(NAME, failure),
    };
    let RecordingMetrics {
        recording,
        ended,
        failed,
    } = metrics.recordings;
    let figures = json!({"recording": recording, "ended": ended, "failed": failed});
    let check = if metrics.warnings.is_empty() {
        let said = format!("{recording} being written, {ended} ended, {failed} failed");
        Check::well(NAME, said)
    } else {
        Check::wrong(NAME, "unwell", metrics.warnings.join("; "), REMEDY)
    };
    check.with(figures)
}

/// Have the recordings of the daemon room to go on?
pub fn recording_space(metrics: &Result<Metrics, Failure>) -> Check {
    match metrics {
        Ok(metrics) => space(metrics.recordings_bytes, metrics.recordings_quota_bytes),
        Err(failure) => Check::failed("recording space", failure),
    }
}

/// The check itself; daemons of earlier versions report no quota.
fn space(bytes: u64, quota: u64) -> Check {
    const NAME: &str = "recording space";
    const REMEDY: &str = "delete what is fetched with `jostle record --delete NAME`, or raise \
                          recordings_quota_mb: recordings that reach it end";
    let said = match quota {
        0 => return Check::untried(NAME, "the daemon is an earlier one, without a quota"),
        _ => format!(
            "recordings take {} of {}",
            format::bytes(bytes),
            format::bytes(quota)
        ),
    };
    let check = match bytes.saturating_mul(10) < quota.saturating_mul(9) {
        true => Check::well(NAME, said),
        false => Check::wrong(NAME, "resource_exhausted", said, REMEDY),
    };
    check.with(json!({"bytes": bytes, "quota_bytes": quota}))
}

/// May this client ask a swarm?
pub async fn gets(bus: &Bus, swarm: Option<&str>) -> Check {
    const NAME: &str = "questions";
    let Some(swarm) = swarm else {
        return Check::well(
            NAME,
            "the daemon answers them; there is no swarm to ask".into(),
        );
    };
    let key = keys::get(bus.prefix(), swarm, "status");
    match bus.ask(Whom::Swarm(swarm), &key, None, PATIENCE).await {
        Ok(_) => Check::well(NAME, format!("the daemon and {swarm} answer them")),
        Err(failure) => Check::failed(NAME, &failure),
    }
}

/// May this client give the daemon commands?
pub async fn commands_to_node(bus: &Bus, node: &str, key: &str) -> Check {
    const NAME: &str = "creating";
    let answer = bus
        .ask(Whom::Node(node), key, Some(Vec::new()), PATIENCE)
        .await;
    commands(NAME, &format!("node {node}"), answer)
}

/// May this client give a swarm commands?
pub async fn commands_to_swarm(bus: &Bus, swarm: Option<&str>) -> Check {
    const NAME: &str = "commands";
    let Some(swarm) = swarm else {
        return Check::untried(NAME, "there is no swarm to try it with");
    };
    let key = keys::cmd(bus.prefix(), swarm, UNKNOWN_VERB);
    let answer = bus
        .ask(Whom::Swarm(swarm), &key, Some(Vec::new()), PATIENCE)
        .await;
    commands(NAME, swarm, answer)
}

/// A command that nobody knows arrived if it was answered so.
fn commands(name: &'static str, whom: &str, answer: Result<Answer, Failure>) -> Check {
    match answer {
        Err(Failure::Refused { error, .. }) if error.code == ErrorCode::NotFound => {
            Check::well(name, format!("{whom} takes commands from this client"))
        }
        // What a role does not give is no trouble; a token that is nobody's is.
        Err(Failure::Refused { error, .. })
            if error.details.get("role").is_some_and(|it| !it.is_null()) =>
        {
            let told = |field: &str| error.details[field].as_str().unwrap_or_default().to_owned();
            let said = format!(
                "you are {}, {}, and give none",
                told("person"),
                told("role")
            );
            Check::untried(name, &said)
        }
        Err(Failure::Silent { whom }) => Check::wrong(
            name,
            "permission_denied",
            format!("{whom} does not take commands from this client"),
            "ask whoever runs the daemon for a role that may change things",
        ),
        Err(failure) => Check::failed(name, &failure),
        Ok(_) => Check::wrong(
            name,
            "internal",
            format!("{whom} took a command that does not exist"),
            "report it: this is a defect",
        ),
    }
}

/// What is published, as far as it reaches this client.
pub struct Listening {
    samples: Result<Vec<Samples>, Failure>,
    end: tokio::time::Instant,
}

impl Listening {
    /// Subscribes to what every swarm publishes: what a running one says, and the sign of life
    /// that one which stands still gives too.
    pub async fn begin(bus: &Bus) -> Self {
        let event = keys::event(bus.prefix(), "*");
        let mut samples = Ok(Vec::new());
        for key in [
            keys::order(bus.prefix(), "*"),
            event.clone(),
            format!("{event}/@adv/**"),
        ] {
            match (&mut samples, bus.subscribe(&key, 1).await) {
                (Ok(samples), Ok(more)) => samples.push(more),
                (samples, Err(failure)) => *samples = Err(failure),
                (Err(_), _) => {}
            }
        }
        let end = tokio::time::Instant::now() + LISTENING;
        Listening { samples, end }
    }

    /// Does anything arrive?
    pub async fn check(self, is_any_swarm: bool) -> Check {
        const NAME: &str = "subscriptions";
        let samples = match &self.samples {
            Ok(samples) => samples,
            Err(failure) => return Check::failed(NAME, failure),
        };
        if !is_any_swarm {
            return Check::untried(NAME, "there is no swarm that publishes anything");
        }
        let [order, event, sign_of_life] = samples.as_slice() else {
            return Check::untried(NAME, "there was nothing to subscribe to");
        };
        let arrived = tokio::time::timeout_at(self.end, async {
            tokio::select! {
                sample = order.recv_async() => sample.is_ok(),
                sample = event.recv_async() => sample.is_ok(),
                sample = sign_of_life.recv_async() => sample.is_ok(),
            }
        });
        match arrived.await {
            Ok(true) => Check::well(NAME, "what swarms publish arrives".into()),
            _ => Check::wrong(
                NAME,
                "permission_denied",
                format!("nothing arrived within {} s", LISTENING.as_secs()),
                "ask whoever runs the daemon for a role that may subscribe; `watch` needs it",
            ),
        }
    }
}

/// Are tokens seen?
pub async fn liveliness(bus: &Bus, node: &str, presence: &[String], swarm: Option<&str>) -> Check {
    const NAME: &str = "liveliness";
    const REMEDY: &str =
        "ask whoever runs the daemon for a role that may see tokens; errors say less without them";
    if !presence.iter().any(|it| it == node) {
        let said = format!("the token of node {node} is not seen");
        return Check::wrong(NAME, "permission_denied", said, REMEDY);
    }
    let Some(swarm) = swarm else {
        return Check::well(NAME, format!("the token of node {node} is seen"));
    };
    match bus.hosts_of(swarm).await {
        Ok(hosts) if hosts.iter().any(|host| host == node) => Check::well(
            NAME,
            format!("the tokens of node {node} and {swarm} are seen"),
        ),
        Ok(_) => {
            let said = format!("the token of {swarm} is not seen");
            Check::wrong(NAME, "permission_denied", said, REMEDY)
        }
        Err(failure) => Check::failed(NAME, &failure),
    }
}

async fn get_node(bus: &Bus, node: &str, noun: &str) -> Result<Answer, Failure> {
    let key = keys::node_get(bus.prefix(), node, noun);
    bus.ask(Whom::Node(node), &key, None, PATIENCE).await
}

fn unix_secs() -> f64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0.0, |since| since.as_secs_f64())
}

#[cfg(test)]
mod tests {
    #![expect(clippy::unwrap_used, reason = "tests")]

    use super::*;

    fn hello(wire_version: u32, unix_secs: f64) -> Hello {
        serde_json::from_value(json!({
            "version": "9.9.9", "wire_version": wire_version, "unix_secs": unix_secs,
            "limits": {
                "max_individuals": 1, "max_swarms": 1, "max_memory_bytes": 1,
                "max_message_bytes": 1, "max_clients": 1, "max_hz": 1,
            },
        }))
        .unwrap()
    }

    fn is_well(check: &Check) -> bool {
        check.to_json()["ok"] == true
    }

    #[test]
    fn recordings_near_their_quota_are_wrong() {
        for (bytes, quota, well) in [(0, 100, true), (89, 100, true), (90, 100, false)] {
            assert_eq!(is_well(&space(bytes, quota)), well, "{bytes} of {quota}");
        }
        assert!(!is_well(&space(u64::MAX, u64::MAX)));
    }

    #[test]
    fn another_wire_version_is_wrong() {
        assert!(is_well(&versions(&hello(WIRE_VERSION, 0.0))));
        assert!(!is_well(&versions(&hello(WIRE_VERSION + 1, 0.0))));
    }

    #[test]
    fn clocks_may_differ_by_what_the_answer_took() {
        let asked = |took| Asked {
            unix_secs: 1000.0,
            took: Duration::from_secs_f64(took),
        };
        assert!(is_well(&clock(&hello(1, 1000.5), asked(0.0))));
        assert!(is_well(&clock(&hello(1, 999.5), asked(0.0))));
        assert!(is_well(&clock(&hello(1, 1003.0), asked(4.0))));
        assert!(!is_well(&clock(&hello(1, 1003.0), asked(0.1))));
        assert!(!is_well(&clock(&hello(1, 997.0), asked(0.1))));
    }
}
