//! Roles, verbs and keys: permitted requests get a reply, others change nothing. The permissions are
//! in `table.rs`, independent of the program.

use std::collections::BTreeMap;

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use super::requests::{RECORDING, Request, SWARM, prepare, record};
use super::secrets::http;
use super::table::{COLUMNS, TABLE, cells, least, may};
use super::{AuthDaemon, UserSession};
use crate::support::{NODE, PREFIX, QueryResult};

/// The sender of a request over zenoh: the person of the session, and of the token.
const SENDERS: [(&str, Token); 8] = [
    ("vera", Token::Of("vera")),
    ("cleo", Token::Of("cleo")),
    ("olga", Token::Of("olga")),
    // A session that may less than the token: only zenoh's access control can reject it.
    ("vera", Token::Of("olga")),
    // Sessions that may more than the token: only the daemon can reject it.
    ("olga", Token::Of("vera")),
    ("olga", Token::Of("cleo")),
    ("olga", Token::None),
    ("olga", Token::Forged),
];

/// The person whose token is sent over HTTP, where it alone identifies the sender.
const HTTP_SENDERS: [Token; 5] = [
    Token::Of("vera"),
    Token::Of("cleo"),
    Token::Of("olga"),
    Token::None,
    Token::Forged,
];

const FORGED: &str = "0123456789abcdef0123456789abcdef";

#[derive(Clone, Copy, Debug)]
enum Token {
    Of(&'static str),
    Forged,
    None,
}

impl Token {
    fn person(self) -> Option<&'static str> {
        match self {
            Token::Of(name) => Some(name),
            Token::Forged | Token::None => None,
        }
    }

    fn text(self, daemon: &AuthDaemon) -> Option<String> {
        match self {
            Token::Of(name) => Some(daemon.credentials(name).token),
            Token::Forged => Some(FORGED.to_owned()),
            Token::None => None,
        }
    }
}

/// The fate of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Fate {
    /// It is executed and gets a reply.
    Carried,
    /// zenoh's access control drops it: no reply.
    Dropped,
    /// The daemon rejects it: `permission_denied`, and over HTTP the status 403.
    Denied,
    /// HTTP rejects a request without a valid token: `permission_denied` and the status 401.
    Unknown,
}

/// The expected fate of a request over zenoh.
fn fate_by_zenoh(cells: [&str; 3], session: &str, token: Token) -> Fate {
    let takes_token = cells.contains(&"no");
    if !may(cells, Some(session)) {
        Fate::Dropped
    } else if takes_token && !may(cells, token.person()) {
        Fate::Denied
    } else {
        Fate::Carried
    }
}

/// The expected fate of a request over HTTP.
fn fate_by_http(cells: [&str; 3], token: Token) -> Fate {
    match token.person() {
        None => Fate::Unknown,
        person if may(cells, person) => Fate::Carried,
        _ => Fate::Denied,
    }
}

/// The fate of a request, from its replies over zenoh.
fn fate_of(answers: &[QueryResult], cells: [&str; 3]) -> Fate {
    match answers {
        [] => Fate::Dropped,
        [Ok(_)] => Fate::Carried,
        [Err(error)] if error.code == ErrorCode::PermissionDenied => {
            let takes = format!("takes {}", least(cells));
            assert!(error.message.contains(&takes), "{error:?}");
            Fate::Denied
        }
        _ => panic!("{answers:?}"),
    }
}

/// The fate of a request, from its response over HTTP.
fn fate_of_http(answer: (u16, Option<String>)) -> Fate {
    let (status, code) = answer;
    match (status, code.as_deref()) {
        (200, None) => Fate::Carried,
        (403, Some("permission_denied")) => Fate::Denied,
        (401, Some("permission_denied")) => Fate::Unknown,
        _ => panic!("{status}: {code:?}"),
    }
}

/// The requests of one row, each prepared when it is needed.
struct Row<'a> {
    key: &'static str,
    olga: &'a UserSession,
    made: usize,
    /// Prepared, and not executed yet.
    ready: Option<Request>,
}

impl Row<'_> {
    /// Sends a request. Fails unless its fate is `expected` and it changes something exactly if it is
    /// a command that is executed.
    async fn send(
        &mut self,
        expected: Fate,
        sender: &str,
        send: impl AsyncFnOnce(&Request) -> Fate,
    ) {
        let request = match self.ready.take() {
            Some(request) => request,
            None => {
                self.made += 1;
                let name = self.key.rsplit_once('/').unwrap().1;
                let name = format!("{name}-{}", self.made);
                Request::of(self.key, &name, self.olga).await
            }
        };
        let context = format!("{} by {sender}", self.key);
        if request.args.is_none() {
            assert_eq!(send(&request).await, expected, "{context}");
            self.ready = Some(request);
            return;
        }
        let before = request.effect(self.olga).await;
        assert_eq!(send(&request).await, expected, "{context}");
        let after = request.effect(self.olga).await;
        if expected == Fate::Carried {
            assert_ne!(after, before, "{context} has no effect");
        } else {
            assert_eq!(after, before, "{context} has an effect");
            self.ready = Some(request);
        }
    }
}

/// Whether it gets a reply. Set-points and tokens get none: `forgery.rs` tests them.
fn is_sent(key: &str) -> bool {
    !key.contains("/ctl/") && !key.contains("/wait/")
}

#[tokio::test(flavor = "multi_thread")]
async fn every_role_may_what_it_may_and_nothing_else() {
    let daemon = AuthDaemon::start().await;
    let olga = daemon.open_session("olga").await;
    prepare(&olga).await;
    let address = daemon.server.http().unwrap().to_string();
    let mut users = Vec::new();
    for (session, token) in SENDERS {
        let token = token.text(&daemon);
        users.push(daemon.open_session_with(session, token.as_deref()).await);
    }
    let whoami = keys::node_get(PREFIX, NODE, "whoami");
    let mut fates = BTreeMap::<Fate, usize>::new();
    for (key, cells) in TABLE {
        if !is_sent(key) {
            continue;
        }
        let mut row = Row {
            key,
            olga: &olga,
            made: 0,
            ready: None,
        };
        for ((session, token), user) in SENDERS.into_iter().zip(&users) {
            let expected = fate_by_zenoh(cells, session, token);
            let sender = format!("the session of {session} with the token {token:?}");
            row.send(expected, &sender, async |request| {
                let answers = user
                    .query_all(&request.selector, request.args.as_ref())
                    .await;
                // The messages of a session arrive in order: a dropped request has no effect after this.
                user.ok(&whoami, None).await;
                fate_of(&answers, cells)
            })
            .await;
            *fates.entry(expected).or_default() += 1;
        }
        for token in HTTP_SENDERS {
            let expected = fate_by_http(cells, token);
            let sender = format!("HTTP with the token {token:?}");
            let text = token.text(&daemon);
            row.send(expected, &sender, async |request| {
                fate_of_http(request.send(&address, text.as_deref()))
            })
            .await;
            *fates.entry(expected).or_default() += 1;
        }
    }
    println!("{fates:?}");
    // Each row was sent by each, and each fate happened often.
    let rows = TABLE.iter().map(|(key, _)| *key).filter(|key| is_sent(key));
    let sent = rows.count() * (SENDERS.len() + HTTP_SENDERS.len());
    assert_eq!(fates.values().sum::<usize>(), sent);
    assert!(
        fates.len() == 4 && fates.values().all(|it| *it > 50),
        "{fates:?}"
    );
    users.push(olga);
    daemon.close(users).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn recordings_are_fetched_by_operators_alone() {
    let daemon = AuthDaemon::start().await;
    let (vera, cleo, olga) = (
        daemon.open_session("vera").await,
        daemon.open_session("cleo").await,
        daemon.open_session("olga").await,
    );
    record(&olga, RECORDING).await;
    let key = keys::node_get(PREFIX, NODE, "recording");
    let film = format!("{key}?name={RECORDING}");
    let piece = olga.ok(&film, None).await["result"].take();
    assert!(piece["length"].as_u64() > Some(1000), "{piece}");
    // zenoh drops the requests of other sessions, with any token.
    let stolen = daemon
        .open_session_with("vera", Some(&daemon.credentials("olga").token))
        .await;
    for who in [&vera, &cleo, &stolen] {
        let answers = who.query_all(&film, None).await;
        assert!(answers.is_empty(), "{answers:?}");
    }
    // The daemon rejects requests over an operator's session with another's token, or none.
    let vera_token = daemon.credentials("vera").token;
    let lent = daemon.open_session_with("olga", Some(&vera_token)).await;
    let silent = daemon.open_session_with("olga", None).await;
    for who in [&lent, &silent] {
        let answers = who.query_all(&film, None).await;
        let [Err(error)] = &answers[..] else {
            panic!("{answers:?}");
        };
        assert_eq!(error.code, ErrorCode::PermissionDenied, "{error:?}");
        assert!(error.message.contains("takes an operator"), "{error:?}");
    }
    // A wildcard does not match it for any role.
    for who in [&vera, &stolen, &olga] {
        for wild in ["*", "recording$*", "**"] {
            let key = keys::node_get(PREFIX, NODE, wild);
            let answers = who
                .query_all(&format!("{key}?name={RECORDING}"), None)
                .await;
            let replies = answers.iter().flatten();
            let has_piece = |answer: &Value| answer["result"].get("length").is_some();
            assert!(!replies.into_iter().any(has_piece), "{wild}: {answers:?}");
        }
    }
    daemon
        .close(vec![vera, cleo, olga, stolen, lent, silent])
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wildcard_executes_nothing_for_any_role() {
    let daemon = AuthDaemon::start().await;
    let mut users = Vec::new();
    for (_, person) in COLUMNS {
        users.push(daemon.open_session(person).await);
    }
    users.push(daemon.open_session_with("olga", None).await);
    let olga = &users[2];
    olga.create(SWARM).await;
    let state = async || {
        let status = olga.ok(&keys::get(PREFIX, SWARM, "status"), None).await;
        ["seq", "epoch", "step", "phase"].map(|field| status[field].clone())
    };
    let before = state().await;
    for key in [
        "jostle/**",
        "jostle/*/cmd/delete",
        "**",
        "jostle/source/cmd/*",
        "jostle/source/cmd/r$*",
        "jostle/@node/*/cmd/*",
    ] {
        for who in &users {
            who.query_all(key, Some(&json!({}))).await;
            assert_eq!(state().await, before, "{key}");
        }
    }
    // A query of every swarm's status gets a reply for each.
    for who in &users {
        let answers = who.query_all(&keys::get(PREFIX, "*", "status"), None).await;
        assert!(matches!(answers[..], [Ok(_)]), "{answers:?}");
    }
    // By its own key the command is executed.
    olga.cmd(SWARM, "delete", json!({})).await;
    daemon.close(users).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_speaks_for_its_own_and_the_journal_says_who() {
    let daemon = AuthDaemon::start().await;
    let (cleo, carl, olga) = (
        daemon.open_session("cleo").await,
        daemon.open_session("carl").await,
        daemon.open_session("olga").await,
    );
    olga.create("s").await;
    let join = |name: &str| json!({"controller": name, "select": {"count": 1}});
    let key = keys::cmd(PREFIX, "s", "join");
    for (who, name) in [
        (&cleo, "carl"),
        (&cleo, "cleo2"),
        (&carl, "cleo-arm"),
        (&carl, "olga"),
    ] {
        let answers = who.query_all(&key, Some(&join(name))).await;
        let [Err(error)] = &answers[..] else {
            panic!("{name}: {answers:?}");
        };
        assert_eq!(error.code, ErrorCode::PermissionDenied);
        assert!(
            error.message.contains("a controller of yours is called"),
            "{error:?}"
        );
    }
    cleo.ok(&key, Some(&join("cleo-arm"))).await;
    let leave = keys::cmd(PREFIX, "s", "leave");
    let not_his = json!({"controller": "cleo-arm"});
    assert!(carl.query_all(&leave, Some(&not_his)).await[0].is_err());
    let claimed = json!({"client": "olga", "args": {"controller": "cleo-arm"}});
    cleo.ok(&leave, Some(&claimed)).await;
    // Operators may send in the name of any client.
    olga.ok(&key, Some(&join("carl"))).await;

    let journal = carl.ok(&keys::get(PREFIX, "s", "journal"), None).await;
    let entries = journal["result"]["entries"].as_array().unwrap().iter();
    let who: Vec<_> = entries
        .map(|entry| entry["client"].as_str().unwrap().to_owned())
        .collect();
    assert_eq!(who, ["cleo", "cleo:olga", "olga"]);
    daemon.close(vec![cleo, carl, olga]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoami_returns_the_person_and_the_permissions() {
    let daemon = AuthDaemon::start().await;
    let key = keys::node_get(PREFIX, NODE, "whoami");
    let address = daemon.server.http().unwrap().to_string();
    let mut users = Vec::new();
    for (role, person) in COLUMNS {
        let may = |kind: &str, verbs: &[&str]| -> Vec<String> {
            let verbs = verbs.iter().filter(|verb| {
                let cells = cells(&format!("{kind}/cmd/{verb}"));
                may(cells, Some(person))
            });
            verbs.map(|verb| (*verb).to_owned()).collect()
        };
        let expected = json!({
            "person": person,
            "role": role,
            "verbs": may("{swarm}", &keys::SWARM_VERBS),
            "node_verbs": may("@node/{node}", &keys::NODE_VERBS),
        });
        let user = daemon.open_session(person).await;
        assert_eq!(user.ok(&key, None).await["result"], expected);
        let get = "GET /api/get/@node/get/whoami";
        let (status, answer) = http(&address, get, user.token.as_deref(), "");
        assert_eq!((status, &answer["result"]), (200, &expected));
        users.push(user);
    }
    let stranger = daemon.open_session_with("vera", Some("no token")).await;
    let whoami = stranger.ok(&key, None).await["result"].take();
    assert_eq!(
        whoami,
        json!({"person": null, "role": null, "verbs": [], "node_verbs": []})
    );
    users.push(stranger);
    daemon.close(users).await;
}
