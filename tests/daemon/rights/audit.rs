//! The audit log of a daemon with users.

use jostle_proto::{ErrorCode, Role, keys};
use jostled::auth::issue;
use serde_json::{Value, json};

use super::secrets::http;
use super::{AuthDaemon, UserSession};
use crate::support::{NODE, PREFIX, until};

/// Each line as user, client, verb, action, name, and how the commands ended.
async fn lines(olga: &UserSession, parameters: &str) -> Vec<String> {
    let key = keys::node_get(PREFIX, NODE, "audit");
    let page = olga.ok(&format!("{key}?{parameters}"), None).await;
    let lines = page["result"]["lines"].as_array().unwrap().iter();
    let line = |line: &Value| {
        let text = |field: &str| line[field].as_str().unwrap_or("-").to_owned();
        let outcomes = line["outcomes"].as_array().unwrap().iter();
        let outcomes: Vec<_> = outcomes
            .map(|it| format!("{} {}", it["outcome"].as_str().unwrap(), it["count"]))
            .collect();
        let fields = ["user", "client", "verb", "action", "name"].map(text);
        format!("{}: {}", fields.join(" "), outcomes.join(", "))
    };
    lines.map(line).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn the_log_names_users_and_has_what_they_may_not() {
    let daemon = AuthDaemon::start().await;
    let (cleo, olga) = (
        daemon.open_session("cleo").await,
        daemon.open_session("olga").await,
    );
    let address = daemon.server.http().unwrap().to_string();
    olga.create("s").await;
    // A client's own name cannot be that of another user.
    let annotate = json!({"client": "olga", "args": {"text": "mine"}});
    cleo.ok(&keys::cmd(PREFIX, "s", "annotate"), Some(&annotate))
        .await;
    let join = json!({"controller": "carl", "select": {"count": 1}});
    let answers = cleo
        .query_all(&keys::cmd(PREFIX, "s", "join"), Some(&join))
        .await;
    assert!(answers[0].is_err(), "{answers:?}");
    let token = daemon.credentials("vera").token;
    for _ in 0..3 {
        let request = "POST /api/cmd/s/delete";
        let (status, reply) = http(&address, request, Some(&token), "{}");
        assert_eq!(
            (status, &reply["code"]),
            (403, &json!("permission_denied")),
            "{reply}"
        );
    }
    let cancel = json!({"client": "page", "args": {"cancel": {"name": "noise"}}}).to_string();
    let request = "POST /api/cmd/@node/experiment";
    let (status, reply) = http(&address, request, Some(&token), &cancel);
    assert_eq!(status, 403, "{reply}");
    // zenoh's access control passes an operator's session on; the token is of nobody.
    let nobody = daemon
        .open_session_with("olga", Some("0123456789abcdef"))
        .await;
    let answers = nobody
        .query_all(&keys::cmd(PREFIX, "s", "reset"), Some(&json!({})))
        .await;
    assert!(answers[0].is_err(), "{answers:?}");
    olga.ok(&keys::cmd(PREFIX, "s", "delete"), Some(&json!({})))
        .await;
    issue::add(&daemon.folder, &[("dora".to_owned(), Role::Viewer)]).unwrap();
    let expected = [
        "olga - create - s: ok 1",
        "cleo olga annotate - s: ok 1",
        "cleo - join - s: permission_denied 1",
        "vera - delete - s: permission_denied 3",
        "vera page experiment cancel noise: permission_denied 1",
        "- - reset - s: permission_denied 1",
        "olga - delete - s: ok 1",
        "- - auth add dora: ok 1",
    ];
    until("the log is complete", async || {
        lines(&olga, "limit=1000").await == expected
    })
    .await;
    assert_eq!(lines(&olga, "user=vera").await, expected[3..5]);
    assert_eq!(lines(&olga, "user=cleo;verb=join").await, expected[2..3]);

    // Only operators read it, by its own key.
    let key = keys::node_get(PREFIX, NODE, "audit");
    assert!(cleo.query_all(&key, None).await.is_empty());
    let lent = daemon
        .open_session_with("olga", Some(&daemon.credentials("cleo").token))
        .await;
    for who in [&lent, &nobody] {
        let answers = who.query_all(&key, None).await;
        let [Err(error)] = &answers[..] else {
            panic!("{answers:?}");
        };
        assert_eq!(error.code, ErrorCode::PermissionDenied);
    }
    let wild = keys::node_get(PREFIX, NODE, "*");
    let answers = olga.query_all(&wild, None).await;
    assert!(answers.len() > 5);
    assert!(
        answers
            .iter()
            .flatten()
            .all(|it| it["result"].get("lines").is_none())
    );
    daemon.close(vec![cleo, olga, nobody, lent]).await;
}
