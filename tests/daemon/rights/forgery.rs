//! Messages that only a daemon may send never arrive when a client sends them.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use jostle_proto::{ErrorCode, keys};
use serde_json::json;
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::query::{ConsolidationMode, QueryTarget, Queryable};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};

use super::table::{COLUMNS, cells};
use super::{AuthDaemon, SessionCredentials, UserSession};
use crate::support::{NODE, PREFIX, TIMEOUT, until};

/// A message or declaration of a client that only the daemon may make, and how its arrival shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Forgery {
    /// A subscriber receives the put.
    Put,
    /// A subscriber receives the delete.
    Delete,
    /// The queryable receives a query.
    Query,
    /// A client that queries receives the reply of the queryable.
    Reply,
    /// A query of liveliness tokens finds the token.
    Token,
}

/// The forgeries that arrived, by kind and key.
type Arrived = Arc<Mutex<BTreeSet<(Forgery, String)>>>;

/// How many samples arrived, by key.
type Counts = Arc<Mutex<BTreeMap<String, usize>>>;

/// The keys that clients put and delete on.
fn published() -> Vec<String> {
    vec![
        keys::state(PREFIX, "s"),
        keys::order(PREFIX, "s"),
        keys::event(PREFIX, "s"),
        keys::state(PREFIX, "another"),
        keys::alive(PREFIX, "s", NODE),
        keys::experiment(PREFIX, NODE, "e", "progress"),
        keys::get(PREFIX, "s", "status"),
        keys::cmd(PREFIX, "s", "pause"),
        keys::node_alive(PREFIX, NODE),
        format!("{}/@adv/pub/0/0/_", keys::event(PREFIX, "s")),
    ]
}

/// The keys of queryables of clients. The last one receives what the first three receive.
fn answered() -> Vec<String> {
    vec![
        keys::state(PREFIX, "s"),
        keys::get(PREFIX, "s", "status"),
        keys::cmd(PREFIX, "s", "pause"),
        keys::node_get(PREFIX, NODE, "hello"),
        keys::node_cmd(PREFIX, NODE, "create"),
        "jostle/**".to_owned(),
    ]
}

/// The liveliness tokens that clients declare. An operator may hold those of any controller, and a
/// router that connects as one brings the claims of other daemons.
fn tokens(is_operator: bool) -> Vec<String> {
    let mut tokens = vec![
        keys::alive(PREFIX, "another", NODE),
        keys::node_alive(PREFIX, "another"),
    ];
    if !is_operator {
        tokens.push(keys::ctl_alive(PREFIX, "s", "carl"));
        tokens.push(keys::claim(PREFIX, "s", "another", "0", "changed"));
        tokens.push(keys::node_claim(PREFIX, NODE, "0", "changed"));
    }
    tokens
}

/// Everything that [`forge`] does.
fn all_forgeries(is_operator: bool) -> BTreeSet<(Forgery, String)> {
    let mut everything = BTreeSet::new();
    for key in published() {
        everything.insert((Forgery::Put, key.clone()));
        everything.insert((Forgery::Delete, key));
    }
    for key in answered() {
        everything.insert((Forgery::Query, key.clone()));
        everything.insert((Forgery::Reply, key));
    }
    let tokens = tokens(is_operator).into_iter();
    everything.extend(tokens.map(|key| (Forgery::Token, key)));
    everything
}

/// The declarations of a forger, until it is dropped.
type Declared = (Vec<Queryable<()>>, Vec<LivelinessToken>);

/// Sends and declares everything from a session. Its queryables note what they receive.
async fn forge(forger: &Session, is_operator: bool, arrived: &Arrived) -> Declared {
    for key in published() {
        forger.put(&key, FORGED).await.unwrap();
        forger.delete(&key).await.unwrap();
    }
    let mut queryables = Vec::new();
    for key in answered() {
        let (declared, arrived) = (key.clone(), arrived.clone());
        let queryable = forger.declare_queryable(&key).callback(move |query| {
            record_arrival(&arrived, Forgery::Query, &declared);
            let key = query.key_expr().clone();
            let _ = query.reply(key, format!("{FORGED}{declared}")).wait();
        });
        queryables.push(queryable.await.unwrap());
    }
    let mut held = Vec::new();
    for key in tokens(is_operator) {
        held.push(forger.liveliness().declare_token(key).await.unwrap());
    }
    (queryables, held)
}

/// The beginning of each forged payload.
const FORGED: &str = "forged ";

fn record_arrival(arrived: &Arrived, forgery: Forgery, key: &str) {
    arrived.lock().unwrap().insert((forgery, key.to_owned()));
}

/// A client that looks for forgeries, and counts what the daemon publishes, by key.
struct Witness {
    arrived: Arrived,
    genuine: Counts,
    _subscribers: Vec<Subscriber<()>>,
}

impl Witness {
    async fn of(session: &Session) -> Self {
        let (arrived, genuine) = (Arrived::default(), Counts::default());
        let mut subscribers = Vec::new();
        for key in ["jostle/**", "jostle/@node/**", "jostle/*/event/@adv/**"] {
            let (arrived, genuine) = (arrived.clone(), genuine.clone());
            let receive = move |sample: Sample| {
                let key = sample.key_expr().as_str();
                let is_forged = sample.payload().to_bytes().starts_with(FORGED.as_bytes());
                // The daemon deletes nothing.
                match sample.kind() {
                    SampleKind::Delete => record_arrival(&arrived, Forgery::Delete, key),
                    SampleKind::Put if is_forged => record_arrival(&arrived, Forgery::Put, key),
                    SampleKind::Put => {
                        let mut genuine = genuine.lock().unwrap();
                        *genuine.entry(key.to_owned()).or_default() += 1;
                    }
                }
            };
            let subscriber = session.declare_subscriber(key).callback(receive);
            subscribers.push(subscriber.await.unwrap());
        }
        Witness {
            arrived,
            genuine,
            _subscribers: subscribers,
        }
    }

    fn count(&self, key: &str) -> usize {
        let genuine = self.genuine.lock().unwrap();
        genuine.get(key).copied().unwrap_or_default()
    }

    /// Queries every key of the forged queryables, and every forged token; how many genuine replies
    /// there are to each query.
    async fn query(&self, session: &Session, is_operator: bool) -> Vec<usize> {
        let mut counts = Vec::new();
        for key in answered().iter().filter(|key| !key.contains('*')) {
            let query = session.get(key).target(QueryTarget::All);
            let query = query.consolidation(ConsolidationMode::None);
            let replies = query.timeout(2 * TIMEOUT).await.unwrap();
            let mut count = 0;
            while let Ok(reply) = replies.recv_async().await {
                let text = reply.result().map(|sample| sample.payload().to_bytes());
                let text = text.map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
                match text.as_ref().map(|text| text.strip_prefix(FORGED)) {
                    Ok(Some(declared)) => record_arrival(&self.arrived, Forgery::Reply, declared),
                    _ => count += 1,
                }
            }
            counts.push(count);
        }
        for key in tokens(is_operator) {
            let tokens = session.liveliness().get(&key).timeout(TIMEOUT);
            let tokens = tokens.await.unwrap();
            while tokens.recv_async().await.is_ok() {
                record_arrival(&self.arrived, Forgery::Token, &key);
            }
        }
        counts
    }
}

/// A router without access control, as a client of a daemon would find it if nothing stopped
/// forgeries: each of them arrives there, so that the test of the daemon can fail.
#[tokio::test(flavor = "multi_thread")]
async fn without_access_control_every_forgery_arrives() {
    let router = open_bare("router", "listen/endpoints", "tcp/127.0.0.1:0").await;
    let endpoint = router.info().locators().await[0].to_string();
    let [forger, session] = [
        open_bare("client", "connect/endpoints", &endpoint).await,
        open_bare("client", "connect/endpoints", &endpoint).await,
    ];
    let witness = Witness::of(&session).await;
    until("the router knows the subscriptions", async || {
        for key in published() {
            router.put(key, "genuine").await.unwrap();
        }
        published().iter().all(|key| witness.count(key) > 0)
    })
    .await;
    let declared = forge(&forger, false, &witness.arrived).await;
    let mut replies = Vec::new();
    until("every forgery arrives", async || {
        replies = witness.query(&session, false).await;
        *witness.arrived.lock().unwrap() == all_forgeries(false)
    })
    .await;
    assert_eq!(replies, [0; 5]);
    drop(declared);
    for session in [forger, session, router] {
        session.close().await.unwrap();
    }
}

/// A zenoh session without access control and without scouting.
async fn open_bare(mode: &str, kind: &str, endpoint: &str) -> Session {
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", json!(mode)),
        ("listen/endpoints", json!([])),
        ("connect/endpoints", json!([])),
        (kind, json!([endpoint])),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("adminspace/enabled", json!(false)),
    ] {
        config.insert_json5(key, &value.to_string()).unwrap();
    }
    zenoh::open(config).await.unwrap()
}

/// People of every role, from the least to the most, send every message that only the daemon may send.
#[tokio::test(flavor = "multi_thread")]
async fn forged_states_answers_and_tokens_never_arrive() {
    let daemon = AuthDaemon::start().await;
    let victor = daemon.open_session("victor").await;
    let olga = daemon.open_session("olga").await;
    // An operator's session, so that its queries of commands pass; without a token, so that the
    // daemon rejects them.
    let asker = daemon.open_session_with("olga", None).await;
    olga.create("s").await;
    let witness = Witness::of(&victor.session).await;
    let whoami = keys::node_get(PREFIX, NODE, "whoami");
    victor.ok(&whoami, None).await;
    // The subscriptions receive what the daemon publishes on the keys that are forged below.
    let toml = "name = \"e\"\nduration = 1\n[[grid]]\nn = [2]\n";
    olga.node_cmd("experiment", json!({"submit": {"toml": toml}}))
        .await;
    let progress = keys::experiment(PREFIX, NODE, "e", "progress");
    expect_published(&witness, &olga, &[&progress]).await;
    for name in ["vera", "cleo", "olga"] {
        let is_operator = name == "olga";
        let forger = daemon.open_session(name).await;
        let declared = forge(&forger.session, is_operator, &witness.arrived).await;
        // The messages of a session arrive in order: all of them before the reply to this query.
        forger.ok(&whoami, None).await;
        let replies = witness.query(&asker.session, is_operator).await;
        assert_eq!(replies, [1; 5], "the daemon replies to each query once");
        // What the daemon publishes later arrives, over the same subscriptions.
        expect_published(&witness, &olga, &[]).await;
        let arrived = witness.arrived.lock().unwrap().clone();
        assert_eq!(arrived, BTreeSet::new(), "forged by {name}");
        drop(declared);
        forger.session.close().await.unwrap();
    }
    let alive = keys::alive(PREFIX, "s", NODE);
    let tokens = victor.session.liveliness().get(&alive).await.unwrap();
    assert!(tokens.recv_async().await.is_ok(), "the daemon's own token");
    daemon.close(vec![victor, olga, asker]).await;
}

/// Waits until a witness has received a new state, order and event of a swarm that steps, and
/// something on each of `others`.
async fn expect_published(witness: &Witness, olga: &UserSession, others: &[&str]) {
    let keys = [keys::state, keys::order, keys::event].map(|key| key(PREFIX, "s"));
    let before = keys.each_ref().map(|key| witness.count(key));
    olga.cmd("s", "set", json!({"pi3": 1.1})).await;
    olga.cmd("s", "step", json!({"steps": 2})).await;
    until("what the daemon publishes arrives", async || {
        let mut counts = keys.iter().zip(before);
        counts.all(|(key, before)| witness.count(key) > before)
            && others.iter().all(|key| witness.count(key) > 0)
    })
    .await;
}

/// The people who send set-points of the controller `cleo` or hold its token, and whether the table
/// permits it.
fn steering(key: &str) -> Vec<(&'static str, bool)> {
    let cells = cells(key);
    // A controller with another name.
    let mut senders = vec![("carl", cells[1] == "yes")];
    let columns = COLUMNS.into_iter().zip(cells);
    senders.extend(columns.map(|((_, person), cell)| (person, cell != "no")));
    senders
}

#[tokio::test(flavor = "multi_thread")]
async fn set_points_are_accepted_only_from_the_owner_of_the_controller() {
    let daemon = AuthDaemon::start().await;
    let (cleo, olga) = (
        daemon.open_session("cleo").await,
        daemon.open_session("olga").await,
    );
    olga.create("s").await;
    let join = json!({"controller": "cleo", "select": {"ids": [1]}, "mode": "free_running",
        "deadline_secs": 10.0});
    cleo.cmd("s", "join", join).await;
    olga.cmd("s", "run", json!({"rate": 1.0})).await;
    let key = keys::ctl(PREFIX, "s", "cleo");
    let taken = async || {
        let reply = olga.ok(&keys::get(PREFIX, "s", "controllers"), None).await;
        let puts = reply["result"]["controllers"][0]["puts"].clone();
        let counts = puts.as_object().unwrap().values();
        counts.map(|count| count.as_u64().unwrap()).sum::<u64>()
    };
    let mut users = vec![cleo];
    let (mut sequence, mut expected) = (0, 0);
    for (person, may) in steering("{swarm}/ctl/{controller}") {
        let user = daemon.open_session(person).await;
        sequence += 1;
        let set = json!({"ids": [1], "direction": [0.5], "weight": [1.0]});
        let payload = json!({"sequence": sequence, "set": set}).to_string();
        let put = user.session.put(&key, payload);
        put.encoding(Encoding::APPLICATION_JSON).await.unwrap();
        // The messages of a session arrive in order.
        let whoami = keys::node_get(PREFIX, NODE, "whoami");
        user.ok(&whoami, None).await;
        expected += u64::from(may);
        until("the permitted set-points are taken", async || {
            taken().await >= expected
        })
        .await;
        assert_eq!(taken().await, expected, "{person}");
        users.push(user);
    }
    assert_eq!(expected, 2);
    users.push(olga);
    daemon.close(users).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controllers_token_is_accepted_only_from_its_owner() {
    let daemon = AuthDaemon::start().await;
    let (victor, olga) = (
        daemon.open_session("victor").await,
        daemon.open_session("olga").await,
    );
    olga.create("s").await;
    let key = keys::ctl_alive(PREFIX, "s", "cleo-2");
    let is_held = async || {
        let tokens = victor.session.liveliness().get(&key).await.unwrap();
        tokens.recv_async().await.is_ok()
    };
    let mut users = Vec::new();
    for (person, may) in steering("{swarm}/ctl/{controller}/alive") {
        let user = daemon.open_session(person).await;
        let token = user.session.liveliness().declare_token(&key);
        let token = token.await.unwrap();
        let whoami = keys::node_get(PREFIX, NODE, "whoami");
        user.ok(&whoami, None).await;
        if may {
            until("the token is there", async || is_held().await).await;
        }
        assert_eq!(is_held().await, may, "{person}");
        token.undeclare().await.unwrap();
        until("the token is gone", async || !is_held().await).await;
        users.push(user);
    }
    users.extend([victor, olga]);
    daemon.close(users).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_role_waits_for_conditions_and_a_user_takes_four_places() {
    let daemon = AuthDaemon::start().await;
    let olga = daemon.open_session("olga").await;
    olga.create("s").await;
    let mut users = Vec::new();
    let mut held = Vec::new();
    for person in ["vera", "cleo", "olga"] {
        let user = daemon.open_session(person).await;
        for k in 0..5 {
            let id = format!("{person}-{k}");
            let key = keys::wait_alive(PREFIX, "s", &id);
            let token = user.session.liveliness().declare_token(&key);
            held.push(token.await.unwrap());
            let noun = format!("wait?condition=order > 1;id={id};timeout_secs=3");
            let replies = user.query_all(&keys::get(PREFIX, "s", &noun), None).await;
            let [Err(error)] = &replies[..] else {
                panic!("{person}: {replies:?}")
            };
            // Without its token a wait ends after 2 s.
            let expected = match k {
                4 => ErrorCode::ResourceExhausted,
                _ => ErrorCode::DeadlineExceeded,
            };
            assert_eq!(error.code, expected, "{person} {k}: {error:?}");
            assert!(k < 4 || error.details["person"] == person, "{error:?}");
            if k == 0 {
                continue;
            }
            // The first one goes on meanwhile.
            let noun = format!("wait?condition=order > 1;id={person}-0;timeout_secs=0.05");
            user.query_all(&keys::get(PREFIX, "s", &noun), None).await;
        }
        users.push(user);
    }
    let status = olga.ok(&keys::get(PREFIX, "s", "status"), None).await;
    let waits = status["result"]["waits"].as_array().unwrap();
    assert!(waits.iter().all(|it| it["user"] == "olga"), "{waits:?}");
    assert_eq!(waits.len(), 4);
    users.push(olga);
    daemon.close(users).await;
}

/// Set-points carry the token of their sender, which suffices to send commands over HTTP.
#[tokio::test(flavor = "multi_thread")]
async fn only_operators_receive_set_points() {
    let daemon = AuthDaemon::start().await;
    let cleo = daemon.open_session("cleo").await;
    let mut users = Vec::new();
    let mut receivers = Vec::new();
    for person in ["vera", "carl", "olga"] {
        let user = daemon.open_session(person).await;
        let counts = Counts::default();
        let mut subscribers = Vec::new();
        for key in ["jostle/**", "jostle/*/ctl/*"] {
            let counts = counts.clone();
            let receive = move |sample: Sample| {
                let mut counts = counts.lock().unwrap();
                *counts.entry(sample.key_expr().to_string()).or_default() += 1;
            };
            let subscriber = user.session.declare_subscriber(key).callback(receive);
            subscribers.push(subscriber.await.unwrap());
        }
        let whoami = keys::node_get(PREFIX, NODE, "whoami");
        user.ok(&whoami, None).await;
        receivers.push((person, counts, subscribers));
        users.push(user);
    }
    let olga = users.last().unwrap();
    olga.create("s").await;
    let (ctl, event) = (keys::ctl(PREFIX, "s", "cleo"), keys::event(PREFIX, "s"));
    let token = cleo.token.clone().unwrap();
    cleo.session
        .put(&ctl, "{}")
        .attachment(token)
        .await
        .unwrap();
    let count = |counts: &Counts, key: &str| counts.lock().unwrap().get(key).copied();
    let (_, operator, _) = receivers.last().unwrap();
    until("the operator receives the set-point", async || {
        count(operator, &ctl).is_some()
    })
    .await;
    // What the daemon publishes later arrives later.
    olga.cmd("s", "set", json!({"pi3": 1.1})).await;
    for (person, counts, _) in &receivers {
        until("the event arrives", async || {
            count(counts, &event).is_some()
        })
        .await;
        assert_eq!(count(counts, &ctl).is_some(), *person == "olga", "{person}");
    }
    drop(receivers);
    users.push(cleo);
    daemon.close(users).await;
}

/// A router forwards the claims of other daemons, and a client can connect as a router.
#[tokio::test(flavor = "multi_thread")]
async fn only_a_router_of_an_operator_brings_claims() {
    let daemon = AuthDaemon::start().await;
    let olga = daemon.open_session("olga").await;
    olga.create("s").await;
    for name in ["vera", "cleo", "olga"] {
        let credentials = SessionCredentials::of(&daemon.folder, name);
        let router = credentials
            .open_as("router", daemon.endpoint("tls"))
            .await
            .unwrap();
        let mut tokens = Vec::new();
        for key in [
            keys::claim(PREFIX, "s", "another", "0", "changed"),
            keys::node_claim(PREFIX, NODE, "0", "changed"),
        ] {
            let token = router.liveliness().declare_token(key);
            tokens.push(token.await.unwrap());
        }
        let key = keys::node_get(PREFIX, NODE, "metrics");
        let mut contested = 0;
        for _ in 0..100 {
            for answer in olga.query_all(&key, None).await {
                match answer {
                    Ok(reply) => contested += reply["result"]["contested"].as_u64().unwrap(),
                    Err(error) => {
                        assert_eq!(error.code, ErrorCode::Contested);
                        contested += 1;
                    }
                }
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        assert_eq!(contested > 0, name == "olga", "{name}: {contested}");
        if name != "olga" {
            olga.cmd("s", "step", json!({"steps": 1})).await;
        }
        router.close().await.unwrap();
    }
    daemon.close(vec![olga]).await;
}
