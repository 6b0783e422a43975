//! Shell completion, the manual, help, and suggestions for typing errors.

use std::process::Command;

use crate::support::{Daemon, Running, Terminal, object};

/// The candidates that bash gets for the last of these words.
fn completed(endpoint: &str, words: &[&str]) -> Vec<String> {
    let output = Command::new(env!("CARGO_BIN_EXE_jostle"))
        .args(["--", "jostle"])
        .args(words)
        .env("JOSTLE_COMPLETE", "bash")
        .env("_CLAP_COMPLETE_INDEX", words.len().to_string())
        .env("JOSTLE_ENDPOINT", endpoint)
        .output()
        .unwrap();
    assert!(
        output.status.success() && output.stderr.is_empty(),
        "{output:?}"
    );
    let candidates = String::from_utf8(output.stdout).unwrap();
    candidates.lines().map(str::to_owned).collect()
}

#[tokio::test(flavor = "multi_thread")]
async fn a_shell_completes_the_names_of_swarms_and_parameters() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 3").await;
    daemon.said("create desk --n 3").await;
    let here = |words: &[&str]| completed(&daemon.endpoint, words);
    assert_eq!(here(&["stat"]), ["status"]);
    assert_eq!(here(&["status", "de"]), ["demo", "desk"]);
    assert_eq!(here(&["delete", "demo", "des"]), ["desk"]);
    assert_eq!(here(&["measures", "de"]), ["demo", "desk"]);
    assert_eq!(
        here(&["measures", "demo", "order", "clusters.n"]),
        ["clusters.n_eff"]
    );
    assert!(here(&["measures", "demo", "msd"]).is_empty());
    assert_eq!(
        here(&["set", "demo", "pi"]),
        ["pi1=", "pi2=", "pi3=", "pi4="]
    );
    // As zsh and fish pass it, and as bash does, which splits the word at `=`.
    let contacts = ["endpoints", "closest", "clamped"];
    let whole = contacts.map(|it| format!("contacts={it}"));
    assert_eq!(here(&["set", "demo", "contacts="]), whole);
    assert_eq!(
        here(&["set", "demo", "pi1=3", "contacts=e"]),
        ["contacts=endpoints"]
    );
    assert_eq!(here(&["set", "demo", "contacts", ""]), contacts);
    assert_eq!(here(&["set", "demo", "contacts", "=", "e"]), ["endpoints"]);
    assert_eq!(
        here(&["set", "demo", "stepping", "=", ""]),
        ["position", "velocity"]
    );
    assert_eq!(here(&["create", "new", "--contacts", "e"]), ["endpoints"]);
    for verb in ["list", "top", "pause", "run", "delete"] {
        let typed = [verb, "--where", "n > 3 and ph"];
        assert_eq!(here(&typed), ["n > 3 and phase"], "{verb}");
    }
    assert_eq!(
        here(&["create", "new", "--contacts=e"]),
        ["--contacts=endpoints"]
    );
    assert_eq!(
        here(&["create", "new", "--contacts", "=", "e"]),
        ["endpoints"]
    );
    assert_eq!(
        here(&["status", "demo", "--nod"]),
        [""; 0],
        "it has no effect there"
    );
    assert_eq!(here(&["list", "--node", ""]), ["test"]);
    assert_eq!(here(&["schema", "batch."]), ["batch.args", "batch.reply"]);
    assert_eq!(
        here(&["schema", "experiment.f"]),
        ["experiment.file", "experiment.file.reply"]
    );
    assert_eq!(here(&["pause", "demo", "--expect-s"]), ["--expect-step"]);
    let named = ["-e", &daemon.endpoint, "status", "des"];
    assert_eq!(completed("tcp/127.0.0.1:1", &named), ["desk"]);
    let unreachable = completed("tcp/127.0.0.1:1", &["status", "de"]);
    assert_eq!(unreachable, [""; 0], "no daemon, and no error");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn each_shell_has_a_line_and_bash_accepts_it() {
    let daemon = Daemon::start().await;
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let line = daemon.said(&format!("completions {shell}")).await;
        assert!(line.contains("JOSTLE_COMPLETE"), "{line}");
        assert_eq!(
            daemon.reply(&format!("completions {shell}")).await["line"],
            line.trim()
        );
    }
    let line = daemon.said("completions bash").await;
    let binary = std::path::Path::new(env!("CARGO_BIN_EXE_jostle"));
    let path = format!(
        "{}:{}",
        binary.parent().unwrap().display(),
        std::env::var("PATH").unwrap()
    );
    let registered = Command::new("bash")
        .args(["-c", &format!("{line}\ncomplete -p jostle")])
        .env("PATH", path)
        .output()
        .unwrap();
    assert!(registered.status.success(), "{registered:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_verb_has_a_page_in_the_manual() {
    let daemon = Daemon::start().await;
    let page = daemon.said("man").await;
    assert!(page.contains(".TH jostle 1"), "{page}");
    assert!(page.contains("Exit codes"), "{page}");
    let directory = std::env::temp_dir().join(format!("jostle-man-{}", std::process::id()));
    let line = format!("man --out {}", directory.display());
    let written = daemon.reply(&line).await;
    let written = written["written"].as_array().unwrap();
    let surface = include_str!("../../surface.txt");
    let is_word = |word: &str| !word.starts_with(['-', '<']);
    let verbs = surface.lines().filter(|line| {
        // Options without a verb are listed under `jostle`.
        line.split(' ').all(is_word) && !line.starts_with("jostle ")
    });
    let verbs = verbs.count();
    assert_eq!(written.len(), verbs + 1, "and one about them all");
    let page = std::fs::read_to_string(directory.join("jostle-set.1")).unwrap();
    let short = directory.join("short");
    let again = daemon.reply(&format!("man -o {}", short.display())).await;
    assert_eq!(again["written"].as_array().unwrap().len(), written.len());
    assert_eq!(
        std::fs::read_to_string(short.join("jostle-set.1")).unwrap(),
        page
    );
    std::fs::remove_dir_all(&directory).unwrap();
    assert!(page.contains(r"\-\-make\-room"), "{page}");
    let ended = daemon.jostle("man --out /proc/nowhere").await;
    assert_eq!(ended.code, Some(1), "{ended:?}");
    let page = daemon.said("man experiment run").await;
    assert!(page.contains("jostle\\-experiment\\-run"), "{page}");
    let ended = daemon.jostle("man fly high").await;
    assert_eq!(ended.code, Some(2), "{ended:?}");
    let expected = "there is no verb `fly high`: `jostle help` lists the verbs";
    assert!(ended.stderr.contains(expected), "{ended:?}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn help_describes_verbs_and_topics() {
    let run = |line| Running::begin("tcp/127.0.0.1:1", line, "").end();
    for (line, text) in [
        ("help", "Usage: jostle [OPTIONS] <VERB>"),
        ("help run", "Usage: jostle run [OPTIONS] [NAME]..."),
        ("help experiment run", "Usage: jostle experiment run"),
        ("experiment help run", "Usage: jostle experiment run"),
        ("help topics", "  exit-codes "),
        ("help selectors", "--fraction 10%"),
        ("help exit-codes", "  130  interrupted"),
        ("help environment", "JOSTLE_CREDENTIALS"),
        ("help credentials", "auth whoami"),
    ] {
        let ended = run(line).await;
        assert_eq!(ended.code, Some(0), "{line}: {ended:?}");
        assert!(ended.stdout.contains(text), "{line}: {ended:?}");
    }
    let json = object(&run("--json help selectors").await);
    assert!(json["help"].as_str().unwrap().contains("--ids"), "{json}");
    for (line, suggestion) in [
        ("help selectros", "did you mean `selectors`?"),
        ("help stauts", "did you mean `status`?"),
        ("help experiment resulst", "did you mean `results`?"),
        ("help xyz", "`jostle help topics`"),
    ] {
        let ended = run(line).await;
        assert_eq!(ended.code, Some(2), "{line}: {ended:?}");
        assert!(ended.stderr.contains(suggestion), "{line}: {ended:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_typing_error_gets_a_suggestion() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 3").await;
    for (line, exit_code, meant) in [
        ("stauts demo", 2, "'status'"),
        ("status demo --tiemout 3", 2, "'--timeout'"),
        ("status dmeo", 3, "did you mean `demo`?"),
        ("pause dem", 3, "did you mean `demo`?"),
        ("list --node tset", 3, "did you mean `test`?"),
        ("set demo pi_1=3", 2, "did you mean `pi1`"),
        (
            "set demo publish-evry=3",
            2,
            "did you mean `publish_every`?",
        ),
        ("schema state.reply", 3, "did you mean"),
    ] {
        let ended = daemon.jostle(line).await;
        assert_eq!(ended.code, Some(exit_code), "{ended:?}");
        assert!(ended.stderr.contains(meant), "{line}: {ended:?}");
    }
    let unknown = daemon.refusal("status dmeo").await;
    assert_eq!(unknown["details"]["nearest"][0], "demo");
    daemon.stop().await;
}

/// Completes in an interactive bash.
#[tokio::test(flavor = "multi_thread")]
async fn bash_completes_the_value_of_an_assignment() {
    let daemon = Daemon::start().await;
    daemon.said("create demo --n 3").await;
    for (typed, completed) in [
        ("jostle set demo contacts=en\t", "contacts=endpoints"),
        ("jostle set demo stepping=v\t", "stepping=velocity"),
        ("jostle set demo conta\ten\t", "contacts=endpoints"),
        ("jostle create new --contacts=en\t", "--contacts=endpoints"),
    ] {
        let mut terminal = Terminal::bash(&daemon.endpoint);
        terminal.until_seen("ready").await;
        terminal.press(typed);
        terminal.until_seen(completed).await;
    }
    daemon.stop().await;
}
