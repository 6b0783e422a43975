//! Roles, verbs and keys: whoever may is answered, whoever may not changes nothing. What each may is
//! in `table.rs`, and nothing here asks the program for it.

use std::collections::BTreeMap;

use jostle_proto::{ErrorCode, keys};
use serde_json::{Value, json};

use super::requests::{RECORDING, Request, SWARM, furnish, record};
use super::secrets::http;
use super::table::{COLUMNS, TABLE, cells, least, may};
use super::{Lab, Visitor};
use crate::support::{Answer, NODE, PREFIX};

/// Who sends a request over zenoh: the person of the session, and whose token they send.
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

/// Whose token is sent over HTTP, where it is all that says who sends.
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

    fn text(self, lab: &Lab) -> Option<String> {
        match self {
            Token::Of(name) => Some(lab.credentials(name).token),
            Token::Forged => Some(FORGED.to_owned()),
            Token::None => None,
        }
    }
}

/// What becomes of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Fate {
    /// It is carried out and answered.
    Carried,
    /// zenoh's access control drops it: no answer.
    Dropped,
    /// The daemon rejects it: `permission_denied`, and over HTTP the status 403.
    Denied,
    /// HTTP rejects whoever sends no valid token: `permission_denied` and the status 401.
    Unknown,
}

/// What must become of a request over zenoh.
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

/// What must become of a request over HTTP.
fn fate_by_http(cells: [&str; 3], token: Token) -> Fate {
    match token.person() {
        None => Fate::Unknown,
        person if may(cells, person) => Fate::Carried,
        _ => Fate::Denied,
    }
}

/// What became of a request, by its answers over zenoh.
fn fate_of(answers: &[Answer], cells: [&str; 3]) -> Fate {
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

/// What became of a request, by its answer over HTTP.
fn fate_of_http(answer: (u16, Option<String>)) -> Fate {
    let (status, code) = answer;
    match (status, code.as_deref()) {
        (200, None) => Fate::Carried,
        (403, Some("permission_denied")) => Fate::Denied,
        (401, Some("permission_denied")) => Fate::Unknown,
        _ => panic!("{status}: {code:?}"),
    }
}

/// The requests of one row, each made ready once it is needed.
struct Row<'a> {
    key: &'static str,
    olga: &'a Visitor,
    made: usize,
    /// Made ready, and not carried out yet.
    ready: Option<Request>,
}

impl Row<'_> {
    /// Sends a request; fails unless its fate is `expected`, and it changes something just if it is
    /// a command that is carried out.
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
        let told = format!("{} by {sender}", self.key);
        if request.args.is_none() {
            assert_eq!(send(&request).await, expected, "{told}");
            self.ready = Some(request);
            return;
        }
        let before = request.effect(self.olga).await;
        assert_eq!(send(&request).await, expected, "{told}");
        let after = request.effect(self.olga).await;
        if expected == Fate::Carried {
            assert_ne!(after, before, "{told} has no effect");
        } else {
            assert_eq!(after, before, "{told} has an effect");
            self.ready = Some(request);
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_role_may_what_it_may_and_nothing_else() {
    let lab = Lab::open().await;
    let olga = lab.enter("olga").await;
    furnish(&olga).await;
    let address = lab.server.http().unwrap().to_string();
    let mut visitors = Vec::new();
    for (session, token) in SENDERS {
        let token = token.text(&lab);
        visitors.push(lab.enter_with(session, token.as_deref()).await);
    }
    let whoami = keys::node_get(PREFIX, NODE, "whoami");
    let mut fates = BTreeMap::<Fate, usize>::new();
    for (key, cells) in TABLE {
        // Set-points and tokens are no requests with an answer: `forgery.rs` judges them.
        if key.contains("/ctl/") {
            continue;
        }
        let mut row = Row {
            key,
            olga: &olga,
            made: 0,
            ready: None,
        };
        for ((session, token), visitor) in SENDERS.into_iter().zip(&visitors) {
            let expected = fate_by_zenoh(cells, session, token);
            let sender = format!("the session of {session} with the token {token:?}");
            row.send(expected, &sender, async |request| {
                let answers = visitor.ask(&request.selector, request.args.as_ref()).await;
                // What a session sends arrives in order: a dropped request has no effect after this.
                visitor.ok(&whoami, None).await;
                fate_of(&answers, cells)
            })
            .await;
            *fates.entry(expected).or_default() += 1;
        }
        for token in HTTP_SENDERS {
            let expected = fate_by_http(cells, token);
            let sender = format!("HTTP with the token {token:?}");
            let text = token.text(&lab);
            row.send(expected, &sender, async |request| {
                fate_of_http(request.send(&address, text.as_deref()))
            })
            .await;
            *fates.entry(expected).or_default() += 1;
        }
    }
    println!("{fates:?}");
    // Of 23 commands 4 are a controller's; of 22 queries 1 is an operator's.
    let expected = [
        (Fate::Carried, 200 + 91),
        (Fate::Dropped, 68),
        (Fate::Denied, 92 + 44),
        (Fate::Unknown, 90),
    ];
    assert_eq!(fates, BTreeMap::from(expected));
    visitors.push(olga);
    lab.close(visitors).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn recordings_are_fetched_by_operators_alone() {
    let lab = Lab::open().await;
    let (vera, cleo, olga) = (
        lab.enter("vera").await,
        lab.enter("cleo").await,
        lab.enter("olga").await,
    );
    record(&olga, RECORDING).await;
    let key = keys::node_get(PREFIX, NODE, "recording");
    let film = format!("{key}?name={RECORDING}");
    let piece = olga.ok(&film, None).await["result"].take();
    assert!(piece["length"].as_u64() > Some(1000), "{piece}");
    // zenoh stops the sessions of others, whatever token comes along.
    let stolen = lab
        .enter_with("vera", Some(&lab.credentials("olga").token))
        .await;
    for who in [&vera, &cleo, &stolen] {
        let answers = who.ask(&film, None).await;
        assert!(answers.is_empty(), "{answers:?}");
    }
    // The daemon stops what comes over an operator's session with another's token, or none.
    let vera_token = lab.credentials("vera").token;
    let lent = lab.enter_with("olga", Some(&vera_token)).await;
    let silent = lab.enter_with("olga", None).await;
    for who in [&lent, &silent] {
        let answers = who.ask(&film, None).await;
        let [Err(error)] = &answers[..] else {
            panic!("{answers:?}");
        };
        assert_eq!(error.code, ErrorCode::PermissionDenied, "{error:?}");
        assert!(error.message.contains("takes an operator"), "{error:?}");
    }
    // A wildcard does not reach it for anybody.
    for who in [&vera, &stolen, &olga] {
        for wild in ["*", "recording$*", "**"] {
            let key = keys::node_get(PREFIX, NODE, wild);
            let answers = who.ask(&format!("{key}?name={RECORDING}"), None).await;
            let told = answers.iter().flatten();
            let has_piece = |answer: &Value| answer["result"].get("length").is_some();
            assert!(!told.into_iter().any(has_piece), "{wild}: {answers:?}");
        }
    }
    lab.close(vec![vera, cleo, olga, stolen, lent, silent])
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_wildcard_executes_nothing_whoever_sends_it() {
    let lab = Lab::open().await;
    let mut everybody = Vec::new();
    for (_, person) in COLUMNS {
        everybody.push(lab.enter(person).await);
    }
    everybody.push(lab.enter_with("olga", None).await);
    let olga = &everybody[2];
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
        for who in &everybody {
            who.ask(key, Some(&json!({}))).await;
            assert_eq!(state().await, before, "{key}");
        }
    }
    // A query of every swarm's status is answered for each.
    for who in &everybody {
        let answers = who.ask(&keys::get(PREFIX, "*", "status"), None).await;
        assert!(matches!(answers[..], [Ok(_)]), "{answers:?}");
    }
    // By its own key the command is executed.
    olga.cmd(SWARM, "delete", json!({})).await;
    lab.close(everybody).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_speaks_for_its_own_and_the_journal_says_who() {
    let lab = Lab::open().await;
    let (cleo, carl, olga) = (
        lab.enter("cleo").await,
        lab.enter("carl").await,
        lab.enter("olga").await,
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
        let answers = who.ask(&key, Some(&join(name))).await;
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
    assert!(carl.ask(&leave, Some(&not_his)).await[0].is_err());
    let claimed = json!({"client": "olga", "args": {"controller": "cleo-arm"}});
    cleo.ok(&leave, Some(&claimed)).await;
    // Operators may speak for anybody.
    olga.ok(&key, Some(&join("carl"))).await;

    let journal = carl.ok(&keys::get(PREFIX, "s", "journal"), None).await;
    let entries = journal["result"]["entries"].as_array().unwrap().iter();
    let who: Vec<_> = entries
        .map(|entry| entry["client"].as_str().unwrap().to_owned())
        .collect();
    assert_eq!(who, ["cleo", "cleo:olga", "olga"]);
    lab.close(vec![cleo, carl, olga]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_asks_is_told_who_they_are_and_what_they_may() {
    let lab = Lab::open().await;
    let key = keys::node_get(PREFIX, NODE, "whoami");
    let address = lab.server.http().unwrap().to_string();
    let mut visitors = Vec::new();
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
        let visitor = lab.enter(person).await;
        assert_eq!(visitor.ok(&key, None).await["result"], expected);
        let get = "GET /api/get/@node/get/whoami";
        let (status, answer) = http(&address, get, visitor.token.as_deref(), "");
        assert_eq!((status, &answer["result"]), (200, &expected));
        visitors.push(visitor);
    }
    let nobody = lab.enter_with("vera", Some("no token")).await;
    let told = nobody.ok(&key, None).await["result"].take();
    assert_eq!(
        told,
        json!({"person": null, "role": null, "verbs": [], "node_verbs": []})
    );
    visitors.push(nobody);
    lab.close(visitors).await;
}
