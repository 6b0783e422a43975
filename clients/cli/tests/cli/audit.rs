//! `audit`: who sent which commands to a daemon.

use serde_json::{Value, json};

use crate::support::{Canned, Running, Terminal, object};

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_of_an_earlier_version_is_reported_with_the_remedy() {
    let canned = Canned::start().await;
    // As such a daemon sends them.
    let known = json!(["hello", "whoami", "status", "swarms"]);
    canned.refuse(json!({
        "code": "not_found", "message": "there is no \"audit\" to get", "details": {"known": known},
    }));
    let ended = Running::begin(&canned.endpoint, "audit", "").end().await;
    ended.assert_stderr(3, "which has no audit log: upgrade it");
    canned.refuse(json!({
        "code": "invalid_argument", "message": "unknown parameter \"verb\"",
        "details": {"field": "verb", "known": ["after", "limit"]},
    }));
    let line = "journal demo --verb set";
    let ended = Running::begin(&canned.endpoint, line, "").end().await;
    ended.assert_stderr(2, "which lists all commands only");
    canned.refuse(json!({
        "code": "invalid_argument", "message": "verb is no verb of a swarm",
        "details": {"field": "verb"},
    }));
    let ended = Running::begin(&canned.endpoint, line, "").end().await;
    assert!(!ended.stderr.contains("earlier version"), "{ended:?}");
    canned.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn damaged_and_missing_lines_are_reported_on_stderr() {
    let canned = Canned::start().await;
    let damaged = ("get/audit", "/result/damaged", json!(2));
    canned.reply_with(std::slice::from_ref(&damaged));
    let ended = Running::begin(&canned.endpoint, "audit --limit 4", "")
        .end()
        .await;
    let text = "2 lines of the audit log cannot be read and are left out: check the disk of lab";
    ended.assert_stderr(0, text);
    assert_eq!(ended.stdout.lines().count(), 5, "{ended:?}");
    let line = "--json audit --limit 4";
    let ended = Running::begin(&canned.endpoint, line, "").end().await;
    ended.assert_stderr(0, text);
    assert_eq!(object(&ended)["result"]["damaged"], 2);
    canned.reply_with(&[("get/audit", "/result/oldest", json!(3))]);
    let ended = Running::begin(&canned.endpoint, "audit --all", "")
        .end()
        .await;
    ended.assert_stderr(0, "the lines before number 3 are no longer kept");
    canned.reply_with(&[("get/audit", "/result/lines", json!([]))]);
    let of = async |line: &str| Running::begin(&canned.endpoint, line, "").end().await;
    of("audit")
        .await
        .assert_stderr(0, "the audit log of lab is empty");
    of("audit --user olga")
        .await
        .assert_stderr(0, "no such command");
    of("audit --verb forks")
        .await
        .assert_stderr(0, "did you mean `fork`?");
    assert_eq!(of("audit").await.stdout, "");
    let backwards = of("audit --since 2h --until 3h").await;
    backwards.assert_stderr(2, "--until: it is before --since");
    of("audit --since 3h --until 2h")
        .await
        .assert_stderr(0, "no such command");
    canned.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_table_fits_a_terminal_of_80_columns() {
    let canned = Canned::start().await;
    let name = "a-client-with-a-name-of-some-forty-letters";
    canned.reply_with(&[("get/audit", "/result/lines/1/client", json!(name))]);
    let terminal = Terminal::begin(&canned.endpoint, "audit --limit 4");
    terminal.until_seen("over.").await;
    let seen = terminal.seen();
    let table = seen.split("when").nth(1).unwrap();
    let table = table.split("code 0.").next().unwrap();
    for line in table.lines() {
        assert!(line.trim_end().chars().count() <= 80, "{seen}");
    }
    // It takes more lines than in a pipe, and the times are whole.
    assert!(table.lines().count() > 5, "{seen}");
    assert_eq!(table.matches("2026-11-24T14:40:01Z").count(), 4, "{seen}");
    assert_eq!(terminal.code().await, "0");
    canned.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_client_cannot_forge_lines_by_its_name() {
    let canned = Canned::start().await;
    let name = "x\n2026-11-24T14:40:01Z  olga  -  delete  school  1  ok\u{1b}[2J";
    canned.reply_with(&[
        ("get/audit", "/result/lines/0/client", json!(name)),
        (
            "get/audit",
            "/result/lines/2/name",
            json!("noise\u{9b}2J\u{202e}"),
        ),
    ]);
    let line = "audit --limit 4";
    let ended = Running::begin(&canned.endpoint, line, "").end().await;
    assert_eq!(ended.stdout.lines().count(), 5, "{ended:?}");
    assert!(ended.stdout.contains(r"x\n2026-11-24"), "{ended:?}");
    assert!(
        !ended.stdout.contains(['\u{1b}', '\u{9b}', '\u{202e}']),
        "{ended:?}"
    );
    let line = "--json audit --limit 4";
    let ended = Running::begin(&canned.endpoint, line, "").end().await;
    let client: &Value = &object(&ended)["result"]["lines"][0]["client"];
    assert_eq!(client, name);
    canned.stop().await;
}
