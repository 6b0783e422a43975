//! A daemon that knows its people, and command lines of theirs.

use std::path::Path;
use std::time::{Duration, Instant};

use jostle_proto::Role;
use jostled::rights::folder::Folder;
use jostled::rights::issue;

use crate::support::Daemon;

const PEOPLE: [(&str, Role); 3] = [
    ("vera", Role::Viewer),
    ("cleo", Role::Controller),
    ("olga", Role::Operator),
];

/// A daemon that listens for others, and says who they are by these folders.
async fn lab(base: &Path) -> (Daemon, impl Fn(&str, &str) -> String) {
    let folder = Folder::at(base.join("auth"));
    let people = PEOPLE.map(|(name, role)| (name.to_owned(), role));
    issue::init(&folder, &["lab.example".into()], &people).unwrap();
    let auth = folder.path().to_str().unwrap().to_owned();
    let settings = [("listen", "tls/127.0.0.1:0"), ("auth_dir", auth.as_str())];
    let daemon = Daemon::with(&settings).await;
    let line = move |person: &str, line: &str| {
        format!("--credentials {} {line}", folder.of(person).display())
    };
    (daemon, line)
}

#[tokio::test(flavor = "multi_thread")]
async fn each_may_what_their_role_may_and_hears_what_it_may_not() {
    let base = tempfile::tempdir().unwrap();
    let (daemon, by) = lab(base.path()).await;
    daemon.said(&by("olga", "create s --n 3")).await;
    for (name, role) in PEOPLE {
        let told = daemon.said(&by(name, "auth whoami")).await;
        assert!(
            told.starts_with(&format!("{name}, {role} on test\n")),
            "{told}"
        );
        daemon.said(&by(name, "status s")).await;
    }
    assert_eq!(
        daemon.said(&by("cleo", "auth can join")).await.trim(),
        "you may join"
    );
    for line in ["pause s", "auth can pause", "delete s"] {
        let ended = daemon.jostle(&by("vera", line)).await;
        assert_eq!(ended.code, Some(5), "{ended:?}");
        assert!(
            ended.stderr.contains("you are vera, a viewer, and "),
            "{ended:?}"
        );
        assert!(ended.stderr.contains("takes an operator"), "{ended:?}");
    }
    let refusal = daemon.refusal(&by("cleo", "create another --n 3")).await;
    assert_eq!(refusal["code"], "permission_denied", "{refusal}");
    let ended = daemon.jostle(&by("vera", "auth can fly")).await;
    assert_eq!(ended.code, Some(2), "{ended:?}");
    daemon.said(&by("olga", "step s 2")).await;
    let examined = daemon.said(&by("vera", "doctor")).await;
    assert!(
        examined.contains("you are vera, viewer, and give none"),
        "{examined}"
    );
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_is_not_let_in_hears_so_soon() {
    let base = tempfile::tempdir().unwrap();
    let (daemon, by) = lab(base.path()).await;
    let elsewhere = tempfile::tempdir().unwrap();
    let strangers = Folder::at(elsewhere.path().join("auth"));
    issue::init(&strangers, &[], &[("olga".into(), Role::Operator)]).unwrap();
    let stranger = format!("--credentials {} list", strangers.of("olga").display());
    for (line, told) in [
        ("list".to_owned(), "say who you are: --credentials FOLDER"),
        (stranger, "does not let olga in"),
    ] {
        let began = Instant::now();
        let ended = daemon.jostle(&line).await;
        assert!(
            began.elapsed() < Duration::from_secs(5),
            "{:?}",
            began.elapsed()
        );
        assert_eq!(ended.code, Some(5), "{ended:?}");
        assert!(ended.stderr.contains(told), "{ended:?}");
    }
    let nowhere = base.path().join("nowhere");
    let line = format!("--credentials {} list", nowhere.display());
    let ended = daemon.jostle(&line).await;
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(ended.stderr.contains("credentials.json"), "{ended:?}");
    let line = by("olga", "-e tcp/192.0.2.1:7447 list");
    let ended = daemon.jostle(&line).await;
    assert_eq!(ended.code, Some(2), "{ended:?}");
    assert!(ended.stderr.contains("in the clear"), "{ended:?}");
    let link = daemon.said(&by("olga", "auth link")).await;
    assert!(link.starts_with("http://127.0.0.1:8080/#token="), "{link}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_knows_nobody_says_so() {
    let daemon = Daemon::start().await;
    let told = daemon.said("auth whoami").await;
    assert!(told.contains("test knows no people"), "{told}");
    daemon.said("auth can delete").await;
    daemon.stop().await;
}
