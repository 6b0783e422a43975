//! A daemon with authentication, and command lines of its users.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use jostle_proto::Role;
use jostle_proto::keys::{NODE_VERBS, SWARM_VERBS};
use jostled::auth::address::AddressChange;
use jostled::auth::folder::Folder;
use jostled::auth::issue;
use serde_json::json;

use crate::support::{Daemon, Running, until};

const PEOPLE: [(&str, Role); 3] = [
    ("vera", Role::Viewer),
    ("cleo", Role::Controller),
    ("olga", Role::Operator),
];

/// A daemon with users, and a function that adds the credentials of a user to a line.
async fn lab(base: &Path) -> (Daemon, impl Fn(&str, &str) -> String) {
    let folder = Folder::new(base.join("auth"));
    let people = PEOPLE.map(|(name, role)| (name.to_owned(), role));
    issue::init(&folder, &["lab.example".into()], &people).unwrap();
    let auth = folder.path().to_str().unwrap().to_owned();
    let settings = [("listen", "tls/127.0.0.1:0"), ("auth_dir", auth.as_str())];
    let daemon = Daemon::with(&settings).await;
    let line = move |person: &str, line: &str| {
        format!(
            "--credentials {} {line}",
            folder.person_folder(person).display()
        )
    };
    (daemon, line)
}

/// The verbs that controllers may send, by the table in `docs/security.md`; operators may send all.
const OF_CONTROLLERS: [&str; 4] = ["join", "advance", "leave", "annotate"];

/// The verbs that cleo may not send, and vera neither; one of a swarm and one of a daemon.
const OF_OPERATORS: [&str; 2] = ["reset", "create"];

#[tokio::test(flavor = "multi_thread")]
async fn whoami_and_can_report_the_permissions_of_each_role() {
    let base = tempfile::tempdir().unwrap();
    let (daemon, by) = lab(base.path()).await;
    let permitted: [(&[&str], &[&str]); 3] = [
        (&[], &[]),
        (&OF_CONTROLLERS, &[]),
        (&SWARM_VERBS, &NODE_VERBS),
    ];
    for ((name, role), (verbs, node_verbs)) in PEOPLE.into_iter().zip(permitted) {
        let of_swarms = [&["watch"], verbs].concat().join(", ");
        let of_daemon = match node_verbs {
            [] => "nothing".to_owned(),
            verbs => verbs.join(", "),
        };
        assert_eq!(
            daemon.said(&by(name, "auth whoami")).await,
            format!("{name}, {role} on test\nof swarms: {of_swarms}\nof the daemon: {of_daemon}")
        );
        let whoami = daemon.reply(&by(name, "auth whoami")).await;
        assert_eq!(whoami["result"]["verbs"], json!(verbs), "{whoami}");
        assert_eq!(
            whoami["result"]["node_verbs"],
            json!(node_verbs),
            "{whoami}"
        );
        for verb in OF_CONTROLLERS.into_iter().chain(OF_OPERATORS) {
            let may = [verbs, node_verbs].concat().contains(&verb);
            let ended = daemon.jostle(&by(name, &format!("auth can {verb}"))).await;
            let text = format!("{name} {verb}: {ended:?}");
            match may {
                true => assert_eq!(ended.stdout, format!("you may {verb}"), "{text}"),
                false => assert!(ended.stderr.contains(&format!("{verb} takes")), "{text}"),
            }
            assert_eq!(ended.code, Some(if may { 0 } else { 5 }), "{text}");
        }
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn each_role_is_enforced_and_an_error_names_the_required_role() {
    let base = tempfile::tempdir().unwrap();
    let (daemon, by) = lab(base.path()).await;
    daemon.said(&by("olga", "create s --n 3")).await;
    for (name, role) in PEOPLE {
        let text = daemon.said(&by(name, "auth whoami")).await;
        assert!(
            text.starts_with(&format!("{name}, {role} on test\n")),
            "{text}"
        );
        daemon.said(&by(name, "status s")).await;
    }
    assert_eq!(
        daemon.said(&by("cleo", "auth can join")).await.trim(),
        "you may join"
    );
    for line in ["pause s", "auth can pause", "delete s"] {
        let ended = daemon.jostle(&by("vera", line)).await;
        ended.assert_stderr(5, "you are vera, a viewer, and ");
        assert!(ended.stderr.contains("takes an operator"), "{ended:?}");
    }
    let refusal = daemon.refusal(&by("cleo", "create another --n 3")).await;
    assert_eq!(refusal["code"], "permission_denied", "{refusal}");
    let ended = daemon.jostle(&by("vera", "auth can fly")).await;
    assert_eq!(ended.code, Some(2), "{ended:?}");
    daemon.said(&by("olga", "step s 2")).await;
    let examined = daemon.said(&by("vera", "doctor")).await;
    assert!(
        examined.contains("you are vera, viewer, which has no commands"),
        "{examined}"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_audit_log_says_who_did_what_to_operators_only() {
    let base = tempfile::tempdir().unwrap();
    let (daemon, by) = lab(base.path()).await;
    for (name, line) in [
        ("olga", "create s --n 3 --client desk"),
        ("cleo", "annotate s ready"),
        ("olga", "step s 2"),
        ("olga", "step s 2"),
        ("olga", "delete s"),
    ] {
        daemon.said(&by(name, line)).await;
    }
    let audit = async |line: &str| -> Vec<String> {
        let reply = daemon.reply(&by("olga", &format!("audit {line}"))).await;
        let lines = reply["result"]["lines"].as_array().unwrap().iter();
        let described = lines.map(|line| {
            let [user, verb, name] = ["user", "verb", "name"].map(|it| line[it].as_str().unwrap());
            let [outcome] = &line["outcomes"].as_array().unwrap()[..] else {
                return line.to_string();
            };
            format!(
                "{user} {verb} {name} {} of {}",
                outcome["outcome"], outcome["count"]
            )
        });
        described.collect()
    };
    let all = [
        "olga create s \"ok\" of 1",
        "cleo annotate s \"ok\" of 1",
        "olga step s \"ok\" of 2",
        "olga delete s \"ok\" of 1",
    ];
    // The daemon stores the outcomes of equal commands once a second. The swarm is gone.
    until("all outcomes", async || audit("--all").await == all).await;
    for (line, expected) in [
        ("--limit 4", &all[..]),
        ("--user cleo", &all[1..2]),
        ("--client desk", &all[..1]),
        ("--verb delete", &all[3..]),
        ("--name s --limit 2", &all[2..]),
        ("--name other", &[]),
        ("--since 1h", &all),
        ("--until 1h", &[]),
    ] {
        assert_eq!(audit(line).await, expected, "{line}");
    }
    let table = daemon
        .said(&by("olga", "audit --user olga --verb step"))
        .await;
    let lines: Vec<Vec<&str>> = table
        .lines()
        .map(|line| line.split_whitespace().collect())
        .collect();
    assert_eq!(
        lines[0],
        [
            "when", "user", "client", "command", "name", "count", "outcome"
        ]
    );
    assert_eq!(lines[1][1], "olga", "{table}");
    assert_eq!(lines[1][3..], ["step", "s", "2", "ok"], "{table}");
    for name in ["vera", "cleo"] {
        let ended = daemon.jostle(&by(name, "audit")).await;
        ended.assert_stderr(5, "and audit takes an operator");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn doctor_reports_credentials_that_were_removed() {
    let base = tempfile::tempdir().unwrap();
    let (daemon, by) = lab(base.path()).await;
    daemon.said(&by("vera", "list")).await;
    let folder = Folder::new(base.path().join("auth"));
    let theirs = base.path().join("olga");
    fs::create_dir(&theirs).unwrap();
    for entry in fs::read_dir(folder.person_folder("olga")).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), theirs.join(entry.file_name())).unwrap();
    }
    issue::remove(&folder, &["olga".into()]).unwrap();
    let line = format!("--credentials {} doctor", theirs.display());
    until("her token is rejected", async || {
        let ended = daemon.jostle(&line).await;
        assert!(!ended.stdout.contains("no-such-verb"), "{ended:?}");
        let text = "node test accepts no commands with the credentials of this client";
        ended.stdout.contains(text)
    })
    .await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rejected_client_gets_an_error_within_seconds() {
    let base = tempfile::tempdir().unwrap();
    let (daemon, by) = lab(base.path()).await;
    let elsewhere = tempfile::tempdir().unwrap();
    let strangers = Folder::new(elsewhere.path().join("auth"));
    issue::init(&strangers, &[], &[("olga".into(), Role::Operator)]).unwrap();
    let stranger = format!(
        "--credentials {} list",
        strangers.person_folder("olga").display()
    );
    for (line, text) in [
        ("list".to_owned(), "pass --credentials FOLDER"),
        (stranger, "rejected olga"),
    ] {
        let began = Instant::now();
        let ended = daemon.jostle(&line).await;
        assert!(
            began.elapsed() < Duration::from_secs(5),
            "{:?}",
            began.elapsed()
        );
        ended.assert_stderr(5, text);
    }
    let nowhere = base.path().join("nowhere");
    let line = format!("--credentials {} list", nowhere.display());
    let ended = daemon.jostle(&line).await;
    ended.assert_stderr(2, "credentials.json");
    let line = by("olga", "-e tcp/192.0.2.1:7447 list");
    let ended = daemon.jostle(&line).await;
    ended.assert_stderr(2, "in the clear");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_link_names_the_address_that_is_served_on() {
    let base = tempfile::tempdir().unwrap();
    let folder = Folder::new(base.path().join("auth"));
    issue::init(&folder, &[], &[("olga".into(), Role::Operator)]).unwrap();
    let (auth, olga) = (
        folder.path().to_str().unwrap(),
        folder.person_folder("olga"),
    );
    let line = |line: &str| format!("--credentials {} {line}", olga.display());
    for (http, scheme) in [("127.0.0.1:0", "http"), ("https://127.0.0.1:0", "https")] {
        let settings = [
            ("listen", "tls/127.0.0.1:0"),
            ("auth_dir", auth),
            ("http", http),
        ];
        let daemon = Daemon::with(&settings).await;
        let link = daemon.said(&line("auth link")).await;
        let (page, token) = link.trim().split_once("/#token=").unwrap();
        assert_eq!(token, folder.credentials("olga").unwrap().token);
        let (its_scheme, address) = page.split_once("://").unwrap();
        assert_eq!(its_scheme, scheme);
        // The port is the daemon's, not the default.
        assert!(!address.ends_with(":8080"), "{address}");
        std::net::TcpStream::connect(address).unwrap();
        let given = daemon
            .said(&line("auth link --page https://lab.example/"))
            .await;
        assert_eq!(given.trim(), format!("https://lab.example/#token={token}"));
        // Without a daemon, too: one that runs admits a new user over zenoh only after a restart.
        let given = line("auth link --page https://lab.example/");
        let given = Running::begin("tls/127.0.0.1:1", &given, "").end().await;
        assert_eq!(given.code, Some(0), "{given:?}");
        assert_eq!(
            given.stdout.trim(),
            format!("https://lab.example/#token={token}")
        );
        daemon.stop().await;
    }
    let settings = [("listen", "tls/127.0.0.1:0"), ("auth_dir", auth)];
    let daemon = Daemon::with(&settings).await;
    let unknown = daemon.jostle("auth link --page https://lab.example").await;
    unknown.assert_stderr(2, "--credentials: is required");
    let ended = daemon.jostle(&line("auth link")).await;
    ended.assert_stderr(2, "reports no HTTP address");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_address_that_the_certificate_does_not_name_is_reported_with_the_remedy() {
    let base = tempfile::tempdir().unwrap();
    let folder = Folder::new(base.path().join("auth"));
    let mut hosts = vec!["lab.example".to_owned(), "fe80::1".to_owned()];
    issue::init(&folder, &hosts, &[("olga".into(), Role::Operator)]).unwrap();
    let auth = folder.path().to_str().unwrap();
    let settings = [("listen", "tls/127.0.0.2:0"), ("auth_dir", auth)];
    let daemon = Daemon::with(&settings).await;
    let line = format!(
        "--credentials {} list",
        folder.person_folder("olga").display()
    );
    let began = Instant::now();
    let ended = daemon.jostle(&line).await;
    assert!(
        began.elapsed() < Duration::from_secs(5),
        "{:?}",
        began.elapsed()
    );
    assert_eq!(ended.code, Some(6), "{ended:?}");
    for text in [
        "does not name 127.0.0.2",
        "it names localhost, 127.0.0.1, ::1, lab.example, fe80::1:",
        "`jostled auth address --host lab.example --host fe80::1 --host 127.0.0.2 \
         --auth-dir FOLDER`",
    ] {
        assert!(ended.stderr.contains(text), "{text}: {ended:?}");
    }
    let refusal = daemon.refusal(&line).await;
    assert_eq!(refusal["code"], "unreachable", "{refusal}");
    assert_eq!(refusal["details"]["host"], "127.0.0.2", "{refusal}");
    daemon.stop().await;
    // The remedy.
    hosts.push("127.0.0.2".to_owned());
    let reach = AddressChange {
        hosts,
        ..AddressChange::default()
    };
    issue::readdress(&folder, &reach).unwrap();
    let daemon = Daemon::with(&settings).await;
    daemon.said(&line).await;
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoami_reports_a_daemon_without_authentication() {
    let daemon = Daemon::start().await;
    let text = daemon.said("auth whoami").await;
    assert!(text.contains("test has no authentication"), "{text}");
    daemon.said("auth can delete").await;
    daemon.stop().await;
}
