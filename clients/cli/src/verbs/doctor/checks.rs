//! The checks of `doctor`. They change nothing.

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use jostle_client::{Client, Error, Payload, Subscription, Target};
use jostle_proto::{
    ErrorCode, Hello, Metrics, NodeReply, NodeStatus, Phase, RecordingMetrics, SwarmSummary,
    Swarms, WIRE_VERSION, keys,
};
use serde_json::json;

use super::report::Check;
use crate::failure::Failure;
use crate::format;

/// A verb that will never exist: the error for an unknown verb shows that commands arrive.
const UNKNOWN_VERB: &str = "no-such-verb-of-the-doctor";
/// The number of queries by which the latency is measured.
const QUERIES: usize = 20;
/// How far clocks may differ before times on two machines are misleading.
const CLOCK_TOLERANCE_SECS: f64 = 1.0;
/// The timeout of a query.
const CHECK_TIMEOUT: Duration = Duration::from_secs(5);
/// How long to wait for a published message: each swarm publishes at least every two seconds.
const LISTEN_TIMEOUT: Duration = Duration::from_secs(5);

/// The times of a query and of its reply.
#[derive(Clone, Copy)]
pub struct Exchange {
    /// The mean of the two times, in seconds since 1970.
    unix_secs: f64,
    /// The time between the two.
    took: Duration,
}

/// The daemon to examine: the one named or the only one, even if its token is not seen.
pub async fn find_node(client: &Client, nodes: &[String]) -> Result<String, Failure> {
    let error = match client.node().await {
        Ok(node) if nodes.is_empty() || nodes.contains(&node) => return Ok(node),
        Ok(node) => Error::UnknownNode {
            node,
            there: nodes.to_vec(),
        },
        Err(error) => error,
    };
    let failure = Failure::from(error);
    if !nodes.is_empty() {
        return Err(failure);
    }
    // Access control may forbid tokens and permit queries.
    let hello = keys::node_get(client.prefix(), "*", "hello");
    let answer = client
        .query_once(Target::Node("*"), &hello, None, CHECK_TIMEOUT)
        .await;
    match answer.and_then(|answer| answer.read::<NodeReply<Hello>>()) {
        Ok(reply) => Ok(reply.node),
        Err(_) => Err(failure),
    }
}

/// The daemon's `hello`, and the time of the query.
pub async fn hello(client: &Client, node: &str) -> Result<(Hello, Exchange), Failure> {
    let (before, began) = (unix_secs(), Instant::now());
    let reply: NodeReply<Hello> = get_node(client, node, "hello").await?.read()?;
    let took = began.elapsed();
    let exchange = Exchange {
        unix_secs: before + took.as_secs_f64() / 2.0,
        took,
    };
    Ok((reply.result, exchange))
}

/// Checks that the daemon replies.
pub async fn daemon(client: &Client, node: &str) -> Result<Check, Failure> {
    let reply: NodeReply<NodeStatus> = get_node(client, node, "status").await?.read()?;
    let status = reply.result;
    let up = format::duration(status.uptime_secs);
    let clients = format::count(status.clients, "client");
    let check = Check::passed(format!("node {node}, up for {up}, {clients}"));
    Ok(check.with(json!({
        "node": node,
        "uptime_secs": status.uptime_secs,
        "clients": status.clients,
    })))
}

/// Checks that the daemon and this program have the same wire version.
pub fn versions(hello: &Hello) -> Check {
    let (theirs, ours) = (hello.wire_version, WIRE_VERSION);
    let text = format!(
        "the daemon is {} with wire version {theirs}, this is {} with wire version {ours}",
        hello.version,
        env!("CARGO_PKG_VERSION"),
    );
    let check = if theirs == ours {
        Check::passed(text)
    } else {
        let older = if theirs < ours {
            "daemon"
        } else {
            "command line"
        };
        let remedy = format!("bring the {older} up to date");
        Check::failed("internal", text, &remedy)
    };
    check.with(json!({"version": hello.version, "wire_version": theirs}))
}

/// Compares the clocks, as precisely as the latency allows.
pub fn clock(hello: &Hello, exchange: Exchange) -> Check {
    let difference = hello.unix_secs - exchange.unix_secs;
    let direction = if difference < 0.0 {
        "behind"
    } else {
        "ahead of"
    };
    let text = format!(
        "the daemon's is {} {direction} this one, give or take {}",
        format::millis(difference.abs()),
        format::millis(exchange.took.as_secs_f64() / 2.0),
    );
    let check = if difference.abs() <= CLOCK_TOLERANCE_SECS + exchange.took.as_secs_f64() {
        Check::passed(text)
    } else {
        let remedy = "let both machines set their clocks by NTP";
        Check::failed("internal", text, remedy)
    };
    check.with(json!({ "difference_secs": difference }))
}

/// Measures the latency of a query.
pub async fn latency(client: &Client, node: &str) -> Result<Check, Failure> {
    let mut took = Vec::with_capacity(QUERIES);
    for _ in 0..QUERIES {
        let began = Instant::now();
        get_node(client, node, "hello").await?;
        took.push(began.elapsed().as_secs_f64());
    }
    took.sort_by(f64::total_cmp);
    let (least, median, most) = (took[0], took[QUERIES / 2], took[QUERIES - 1]);
    let check = Check::passed(format!(
        "a reply takes {} (median of {QUERIES}; {} to {})",
        format::millis(median),
        format::millis(least),
        format::millis(most),
    ));
    Ok(check.with(json!({
        "questions": QUERIES,
        "min_secs": least,
        "median_secs": median,
        "max_secs": most,
    })))
}

/// The swarms of the daemon.
pub async fn list(client: &Client, node: &str) -> Result<Vec<SwarmSummary>, Failure> {
    let reply: NodeReply<Swarms> = get_node(client, node, "swarms").await?.read()?;
    Ok(reply.result.swarms)
}

/// Counts the swarms.
pub fn swarms(swarms: &[SwarmSummary]) -> Check {
    let in_phase = |phase| swarms.iter().filter(|swarm| swarm.phase == phase).count();
    let (running, faulted) = (in_phase(Phase::Running), in_phase(Phase::Faulted));
    let check = Check::passed(match swarms.len() {
        0 => "none".into(),
        count => format!("{count}, of which {running} running and {faulted} faulted"),
    });
    check.with(json!({"swarms": swarms.len(), "running": running, "faulted": faulted}))
}

/// The metrics of the daemon.
pub async fn metrics(client: &Client, node: &str) -> Result<Metrics, Failure> {
    let reply: NodeReply<Metrics> = get_node(client, node, "metrics").await?.read()?;
    Ok(reply.result)
}

/// The name of a check of the metrics, and the check.
type MetricsCheck = (&'static str, fn(&Metrics) -> Check);

/// The checks of the metrics.
pub const OF_METRICS: [MetricsCheck; 4] = [
    ("health", health),
    ("recordings", recordings),
    ("recording space", |it| {
        space(it.recordings_bytes, it.recordings_quota_bytes)
    }),
    ("experiment space", experiment_space),
];

/// Checks the health of the daemon.
fn health(metrics: &Metrics) -> Check {
    const REMEDY: &str = "see its log, and /healthz in docs/health.md";
    let [_, others] = warnings(metrics);
    let problems = [metrics.unwell.clone(), others].concat();
    match problems.as_slice() {
        [] => Check::passed("its threads and its disk work"),
        problems => Check::failed("unwell", problems.join("; "), REMEDY),
    }
}

/// The daemon's warnings about recordings, and the others.
fn warnings(metrics: &Metrics) -> [Vec<String>; 2] {
    let warnings = metrics.warnings.iter().cloned();
    let (recordings, others) = warnings.partition(|it| it.starts_with("recordings failed"));
    [recordings, others]
}

/// Checks for failed recordings of the daemon.
fn recordings(metrics: &Metrics) -> Check {
    const REMEDY: &str =
        "copy what you need of recordings/NAME in its data directory before you delete one";
    let RecordingMetrics {
        recording,
        ended,
        failed,
    } = metrics.recordings;
    let figures = json!({"recording": recording, "ended": ended, "failed": failed});
    let [warnings, _] = warnings(metrics);
    let check = match warnings.as_slice() {
        [] => Check::passed(format!(
            "{recording} being written, {ended} ended, {failed} failed"
        )),
        warnings => Check::failed("unwell", warnings.join("; "), REMEDY),
    };
    check.with(figures)
}

/// Checks the quota of recordings; daemons of earlier versions report none.
fn space(bytes: u64, quota: u64) -> Check {
    const REMEDY: &str = "delete what is fetched with `jostle record --delete NAME`, or raise \
                          recordings_quota_mb: recordings that reach it end";
    let text = match quota {
        0 => return Check::skipped("the daemon is an earlier one, without a quota"),
        _ => format!(
            "recordings take {} of {}",
            format::bytes(bytes),
            format::bytes(quota)
        ),
    };
    let check = match bytes.saturating_mul(10) < quota.saturating_mul(9) {
        true => Check::passed(text),
        false => Check::failed("resource_exhausted", text, REMEDY),
    };
    check.with(json!({"bytes": bytes, "quota_bytes": quota}))
}

/// Checks the quota of experiments, if there is one.
fn experiment_space(metrics: &Metrics) -> Check {
    const REMEDY: &str = "delete what is fetched with `jostle experiment delete NAME`, or raise \
                          experiments_quota_mb: the experiment that reaches it is paused";
    let quota = metrics.experiments_quota_bytes;
    let Some(bytes) = metrics.experiments_bytes else {
        return Check::skipped("the daemon is an earlier one, which does not count them");
    };
    let text = format!("experiments take {}", format::bytes(bytes));
    let of_quota = |quota| format!("{text} of {}", format::bytes(quota));
    let check = match quota {
        None => Check::passed(format!("{text}, without a quota")),
        Some(quota) if bytes.saturating_mul(10) < quota.saturating_mul(8) => {
            Check::passed(of_quota(quota))
        }
        Some(quota) => Check::failed("resource_exhausted", of_quota(quota), REMEDY),
    };
    check.with(json!({"bytes": bytes, "quota_bytes": quota}))
}

/// Checks that queries to a swarm are permitted.
pub async fn queries(client: &Client, swarm: Option<&str>) -> Result<Check, Failure> {
    let Some(swarm) = swarm else {
        return Ok(Check::passed(
            "the daemon replies; there is no swarm to query",
        ));
    };
    let key = keys::get(client.prefix(), swarm, "status");
    let status = client.query_once(Target::Swarm(swarm), &key, None, CHECK_TIMEOUT);
    status.await?;
    let text = format!("the daemon and {swarm} reply to queries");
    Ok(Check::passed(text))
}

/// Checks that commands to the daemon are permitted.
pub async fn commands_to_node(client: &Client, node: &str) -> Check {
    let key = keys::node_cmd(client.prefix(), node, UNKNOWN_VERB);
    commands(client, Target::Node(node), &key).await
}

/// Checks that commands to a swarm are permitted.
pub async fn commands_to_swarm(client: &Client, swarm: Option<&str>) -> Check {
    let Some(swarm) = swarm else {
        return Check::skipped("there is no swarm to try it with");
    };
    let key = keys::cmd(client.prefix(), swarm, UNKNOWN_VERB);
    commands(client, Target::Swarm(swarm), &key).await
}

/// Sends an unknown verb: the target received it if it rejected it as unknown.
async fn commands(client: &Client, target: Target<'_>, key: &str) -> Check {
    let answer = client.query_once(target, key, Some(Vec::new()), CHECK_TIMEOUT);
    let failure = match answer.await {
        Err(error) => Failure::from(error),
        Ok(_) => {
            let text = format!("{target} accepted a command that does not exist");
            return Check::failed("internal", text, "report it: this is a defect");
        }
    };
    match failure.cause() {
        Some(Error::Rejected(error)) if error.code == ErrorCode::NotFound => {
            Check::passed(format!("{target} accepts commands from this client"))
        }
        // A role without commands is as configured; a token without a role is not.
        Some(Error::Rejected(error))
            if error.details.get("role").is_some_and(|it| !it.is_null()) =>
        {
            let field = |name: &str| error.details[name].as_str().unwrap_or_default();
            let (person, role) = (field("person"), field("role"));
            Check::skipped(format!("you are {person}, {role}, which has no commands"))
        }
        // Its message names the verb, which is not one.
        Some(Error::Rejected(error)) if error.code == ErrorCode::PermissionDenied => Check::failed(
            failure.code(),
            format!("{target} accepts no commands with the credentials of this client"),
            "they may have been removed: ask the operator of the daemon for new ones",
        ),
        Some(Error::Silent { .. }) => Check::failed(
            failure.code(),
            format!("{target} does not accept commands from this client"),
            "ask the operator of the daemon for a role with commands",
        ),
        _ => Check::of_failure(&failure),
    }
}

/// Subscriptions to what the swarms publish.
pub struct Listening {
    samples: [Subscription; 3],
    end: tokio::time::Instant,
}

impl Listening {
    /// Subscribes to the order of every swarm, which also a paused swarm publishes.
    pub async fn begin(client: &Client) -> Result<Self, Failure> {
        let event = keys::event(client.prefix(), "*");
        let samples = [
            client
                .subscribe(&keys::order(client.prefix(), "*"), 1)
                .await?,
            client.subscribe(&event, 1).await?,
            client.subscribe(&format!("{event}/@adv/**"), 1).await?,
        ];
        let end = tokio::time::Instant::now() + LISTEN_TIMEOUT;
        Ok(Listening { samples, end })
    }

    /// Checks that a message arrives.
    pub async fn check(self, is_any_swarm: bool) -> Check {
        if !is_any_swarm {
            return Check::skipped("there is no swarm that publishes anything");
        }
        let [order, event, sign_of_life] = &self.samples;
        let arrived = tokio::time::timeout_at(self.end, async {
            tokio::select! {
                sample = order.next() => sample.is_ok(),
                sample = event.next() => sample.is_ok(),
                sample = sign_of_life.next() => sample.is_ok(),
            }
        });
        match arrived.await {
            Ok(true) => Check::passed("messages that swarms publish arrive"),
            _ => Check::failed(
                "permission_denied",
                format!("nothing arrived within {} s", LISTEN_TIMEOUT.as_secs()),
                "ask the operator of the daemon for a role that may subscribe; `watch` needs it",
            ),
        }
    }
}

/// Checks that tokens are visible.
pub async fn liveliness(
    client: &Client,
    node: &str,
    nodes: &[String],
    swarm: Option<&str>,
) -> Result<Check, Failure> {
    const REMEDY: &str = "ask the operator of the daemon for a role that may see tokens; errors have less detail without";
    let hidden = |whose: &str| {
        let text = format!("the token of {whose} is not visible");
        Ok(Check::failed("permission_denied", text, REMEDY))
    };
    if !nodes.iter().any(|it| it == node) {
        return hidden(&format!("node {node}"));
    }
    let Some(swarm) = swarm else {
        let text = format!("the token of node {node} is visible");
        return Ok(Check::passed(text));
    };
    if !client
        .hosts_of(swarm)
        .await?
        .iter()
        .any(|host| host == node)
    {
        return hidden(swarm);
    }
    let text = format!("the tokens of node {node} and {swarm} are visible");
    Ok(Check::passed(text))
}

async fn get_node(client: &Client, node: &str, noun: &str) -> Result<Payload, Failure> {
    let key = keys::node_get(client.prefix(), node, noun);
    let answer = client.query_once(Target::Node(node), &key, None, CHECK_TIMEOUT);
    Ok(answer.await?)
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

    fn is_passed(check: &Check) -> bool {
        check.to_json("")["ok"] == true
    }

    #[test]
    fn a_warning_that_is_not_of_recordings_belongs_to_the_health() {
        let reply = include_str!("../../../../../proto/fixtures/node.metrics.reply.json");
        let reply: NodeReply<Metrics> = serde_json::from_str(reply).unwrap();
        let mut metrics = reply.result;
        metrics.unwell.clear();
        let checks =
            |metrics: &Metrics| [is_passed(&health(metrics)), is_passed(&recordings(metrics))];
        assert_eq!(checks(&metrics), [true, false]);
        metrics.warnings = vec!["3 damaged or missing records were read".to_owned()];
        assert_eq!(checks(&metrics), [false, true]);
    }

    #[test]
    fn recordings_near_their_quota_are_wrong() {
        for (bytes, quota, well) in [(0, 100, true), (89, 100, true), (90, 100, false)] {
            assert_eq!(is_passed(&space(bytes, quota)), well, "{bytes} of {quota}");
        }
        assert!(!is_passed(&space(u64::MAX, u64::MAX)));
    }

    #[test]
    fn experiments_near_their_quota_are_wrong() {
        let reply = include_str!("../../../../../proto/fixtures/node.metrics.reply.json");
        let reply: NodeReply<Metrics> = serde_json::from_str(reply).unwrap();
        for (bytes, quota, well) in [
            (Some(79), Some(100), json!(true)),
            (Some(80), Some(100), json!(false)),
            (Some(u64::MAX), None, json!(true)),
            (None, None, json!(null)),
        ] {
            let mut metrics = reply.result.clone();
            (metrics.experiments_bytes, metrics.experiments_quota_bytes) = (bytes, quota);
            let check = experiment_space(&metrics).to_json("");
            assert_eq!(check["ok"], well, "{bytes:?} of {quota:?}");
        }
    }

    #[test]
    fn another_wire_version_is_wrong() {
        assert!(is_passed(&versions(&hello(WIRE_VERSION, 0.0))));
        assert!(!is_passed(&versions(&hello(WIRE_VERSION + 1, 0.0))));
    }

    #[test]
    fn clocks_may_differ_by_the_latency() {
        let exchange = |took| Exchange {
            unix_secs: 1000.0,
            took: Duration::from_secs_f64(took),
        };
        assert!(is_passed(&clock(&hello(1, 1000.5), exchange(0.0))));
        assert!(is_passed(&clock(&hello(1, 999.5), exchange(0.0))));
        assert!(is_passed(&clock(&hello(1, 1003.0), exchange(4.0))));
        assert!(!is_passed(&clock(&hello(1, 1003.0), exchange(0.1))));
        assert!(!is_passed(&clock(&hello(1, 997.0), exchange(0.1))));
    }
}
