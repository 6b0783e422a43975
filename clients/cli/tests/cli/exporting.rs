//! HTML files that re-run a swarm or a run, and their check.

use std::fs;
use std::path::{Path, PathBuf};

use jostle_experiment::html::{Claim, ClaimedRun, Content, HtmlFile};
use jostle_experiment::{Execution, ExecutionControl, Folder, Plan, Subset, execute};
use serde_json::{Value, json};

use crate::support::{Daemon, Ended, Running, object};

/// `printf '\0asm\1\0\0\0' | gzip -9n`: the least module.
pub const MODULE: [u8; 28] = [
    0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 2, 3, 0x63, 0x48, 0x2c, 0xce, 0x65, 0x64, 0x60, 0x60, 0, 0, 0xce,
    0x33, 0x4b, 0x1c, 8, 0, 0, 0,
];

/// The text of a file with the second run of an experiment.
pub fn claimed(toml: &str) -> String {
    let plan = Plan::parse(toml).unwrap();
    let run = &plan.runs()[1];
    let claim = Claim::of(&plan, run, |_| true).unwrap().unwrap();
    let run = ClaimedRun::new(&plan, run, claim);
    let file = HtmlFile::new(plan.name, "", Content::Run(Box::new(run)));
    file.fill("{{jostle:title}}<script type=\"application/json\" id=\"jostle-file\">{{jostle:file}}</script>{{jostle:module}}</html>", None)
        .unwrap()
}

/// A run of up to 2,000 steps that ends after 10: then there is no individual 3 yet.
const EARLY: &str = "name = 'early'\nduration = 40\nspec = { n = 3 }\n\
    setpoints = \"\"\"\nstep,id,direction\n10,3,1\n\"\"\"\n[[at]]\nstep = 40\ninject = { count = 1 }\n";

/// Files of a test, and the options of the module.
struct Files {
    folder: tempfile::TempDir,
    wasm: String,
}

impl Files {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let module = folder.path().join("jostle.wasm.gz");
        fs::write(&module, MODULE).unwrap();
        fs::write(folder.path().join("licences.txt"), "the licence of std").unwrap();
        let wasm = format!("--wasm {}", module.display());
        Self { folder, wasm }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn write(&self, name: &str, text: &str) -> String {
        fs::write(self.path(name), text).unwrap();
        self.path(name).display().to_string()
    }
}

/// Executes a run of an experiment, by its number; returns the folder of results.
fn executed(files: &Files, plan: &Plan, run: &str) -> PathBuf {
    let results = files.path("results");
    let mut folder = Folder::open(&results, plan).unwrap();
    let execution = Execution {
        plan,
        subset: &Subset::parse(plan, run).unwrap(),
        threads: 1,
        checkpoint_every: None,
    };
    execute(execution, &mut folder, &ExecutionControl::new()).unwrap();
    results
}

/// Runs a command line that needs no daemon.
async fn alone(line: &str) -> Ended {
    Running::begin("tcp/127.0.0.1:9", line, "").end().await
}

/// The data of a file, as a browser finds them.
fn data(path: &Path) -> Value {
    let html = fs::read_to_string(path).unwrap();
    let (_, data) = html.split_once("id=\"jostle-file\">").unwrap();
    serde_json::from_str(data.split_once("</script>").unwrap().0).unwrap()
}

async fn checked(path: &Path) -> Ended {
    alone(&format!("check {}", path.display())).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_swarm_is_exported_and_an_altered_command_is_found() {
    let (daemon, files) = (Daemon::start().await, Files::new());
    daemon.said("create school --n 12 --seed 3").await;
    daemon.said("step school 40").await;
    daemon.said("inform school --count 3 --direction 0.5").await;
    daemon.said("step school 160").await;
    let hash = daemon.reply("status school").await["result"]["state_hash"].clone();
    let path = files.path("school.html");
    let line = format!("export school -o {} {}", path.display(), files.wasm);
    let said = daemon.said(&line).await;
    assert!(said.contains("after 200 steps: "), "{said}");
    let refusal = daemon.refusal(&line).await;
    assert!(
        refusal["message"].as_str().unwrap().contains("--force"),
        "{refusal}"
    );
    let printed = daemon.reply(&format!("{line} --force")).await;
    assert_eq!(printed["claim"], json!({"steps": 200, "state_hash": hash}));
    daemon.stop().await;

    let data = data(&path);
    assert_eq!(data["claim"], printed["claim"]);
    assert_eq!(
        (&data["kind"], &data["name"]),
        (&json!("run"), &json!("school"))
    );
    // `printf 'the licence of std' | gzip -9n | base64 | cut -c 1-12`
    assert!(
        data["licences"]
            .as_str()
            .unwrap()
            .starts_with("H4sIAAAAAAAC")
    );
    let html = fs::read_to_string(&path).unwrap();
    assert_eq!(printed["bytes"], html.len());
    assert!(html.contains("<title>school</title>"));
    assert!(html.contains(">H4sIAAAAAAACA2NILM5lZGBgAADOM0scCAAAAA==</script>"));
    assert!(html.len() < 400_000, "without the module: {}", html.len());

    let ended = checked(&path).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let hash = hash.as_str().unwrap();
    assert_eq!(ended.stdout, format!("equal after 200 steps: {hash}"));
    let ended = alone(&format!("--json check {}", path.display())).await;
    let found = json!({"steps": 200, "state_hash": hash});
    assert_eq!(
        object(&ended),
        json!({"equal": true, "found": found, "claim": found})
    );

    let altered = html.replacen("direction = 0.5", "direction = 0.25", 1);
    assert_ne!(altered, html);
    let altered = files.write("altered.html", &altered);
    let ended = alone(&format!("check {altered}")).await;
    ended.assert_stderr(1, "does not end as the file states");
    assert!(
        ended
            .stdout
            .starts_with("different: the run ends after 200 steps: "),
        "{ended:?}"
    );
    assert!(ended.stdout.contains(hash), "{ended:?}");
    let ended = alone(&format!("--json check {altered}")).await;
    assert_eq!(ended.json_lines()[0]["equal"], false);
    let error: Value = serde_json::from_str(&ended.stderr).unwrap();
    assert_eq!(error["code"], "different");
}

#[tokio::test(flavor = "multi_thread")]
async fn commands_at_the_present_step_are_followed_by_a_step() {
    let (daemon, files) = (Daemon::start().await, Files::new());
    daemon.said("create school --n 9 --seed 3").await;
    daemon.said("step school 10").await;
    daemon.said("set school pi3=1.5").await;
    let path = files.path("school.html");
    let line = format!("export school -o {} {}", path.display(), files.wasm);
    let ended = daemon.jostle(&line).await;
    ended.assert_stderr(0, "commands were applied at step 10");
    daemon.said("step school 1").await;
    let hash = daemon.reply("status school").await["result"]["state_hash"].clone();
    assert_eq!(
        data(&path)["claim"],
        json!({"steps": 11, "state_hash": hash})
    );
    // What the daemon cannot repeat, a file cannot.
    daemon.said("fork school copy").await;
    let refusal = daemon
        .refusal(&format!("export copy -o {}.2", path.display()))
        .await;
    assert_eq!(refusal["code"], "conflict");
    let message = refusal["message"].as_str().unwrap();
    for part in [
        "snapshot of it as start of a file",
        "`jostle export FILE.toml`",
    ] {
        assert!(message.contains(part), "{message}");
    }
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_is_played_and_states_nothing() {
    let (daemon, files) = (Daemon::start().await, Files::new());
    daemon.said("create school --n 50 --seed 3").await;
    let recording = files.path("school.mcap").display().to_string();
    let recording_line = daemon.begin(&format!(
        "record school -o {recording} --every 10 --steps 1900"
    ));
    daemon.until_recording().await;
    daemon.said("run school --rate max --until-step 2000").await;
    let ended = recording_line.end().await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    daemon.stop().await;
    let path = files.path("school.html");
    let line = format!("export {recording} -o {}", path.display());
    let printed = object(&alone(&format!("--json {line}")).await);
    assert_eq!(
        (&printed["claim"], &printed["has_engine"]),
        (&Value::Null, &json!(false))
    );
    let data = data(&path);
    assert_eq!(
        (&data["kind"], &data["name"]),
        (&json!("recording"), &json!("school"))
    );
    let frames = &data["frames"];
    assert_eq!(
        (&frames["dt"], &frames["pi1"]),
        (&json!(0.02), &json!([[0, 4.0]]))
    );
    assert!(
        frames["count"].as_u64().unwrap() >= 190,
        "{}",
        frames["count"]
    );
    let bytes = frames["data"].as_str().unwrap().len();
    assert!(bytes < 42_000, "{bytes} for {}", frames["count"]);
    checked(&path).await.assert_stderr(2, "is a recording");
    let ended = alone(&format!("{line}.2 --run 1")).await;
    ended.assert_stderr(2, "only an experiment has runs");
    let ended = alone(&format!("export {recording}.mcap -o {recording}.html")).await;
    assert_eq!(
        ended.stderr.matches("school.mcap.mcap").count(),
        1,
        "{ended:?}"
    );
    let other = files.write("other.mcap", "no recording");
    alone(&format!("export {other} -o {other}.html"))
        .await
        .assert_stderr(2, "other.mcap");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_run_of_an_experiment_is_exported_from_its_file_or_its_results() {
    const TOML: &str =
        "# </script><!-- </title>\nname = 'order'\nreplicates = 2\nduration = 3\n[spec]\nn = 6\n";
    let files = Files::new();
    let toml = files.write("order.toml", TOML);
    let (one, other) = (files.path("one.html"), files.path("other.html"));
    let line = format!("export {toml} --run 2 -o {} {}", one.display(), files.wasm);
    let ended = alone(&line).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let data_of_one = data(&one);
    assert_eq!(data_of_one["files"]["toml"], TOML);
    assert_eq!(data_of_one["run"], json!({"index": 1, "name": "#1"}));
    assert_eq!(data_of_one["claim"]["steps"], 150);
    assert_eq!(data_of_one.get("frames"), None);
    assert_eq!(checked(&one).await.code, Some(0));

    let results = executed(&files, &Plan::parse(TOML).unwrap(), "2");
    let line = format!(
        "export {} -o {} --no-engine",
        results.display(),
        other.display()
    );
    alone(&line).await.assert_stderr(2, "is not finished");
    let ended = alone(&format!("{line} --run #1")).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let data_of_other = data(&other);
    assert_eq!(data_of_other["claim"], data_of_one["claim"]);
    assert_eq!(data_of_other["frames"]["count"], 151);
    let html = fs::read_to_string(&other).unwrap();
    assert!(html.contains("id=\"jostle-module\"></script>"));
    assert!(
        ended.stdout.contains("run 2, \"#1\", of order"),
        "{ended:?}"
    );
    assert_eq!(checked(&other).await.code, Some(0));
    let ended = alone(&format!("export {toml} --run 3 -o {}.3", one.display())).await;
    ended.assert_stderr(2, "there is no run \"3\"");
    let ended = alone(&format!(
        "export {toml} -o {}.4 --wasm {toml}",
        one.display()
    ))
    .await;
    ended.assert_stderr(2, "no module compressed by gzip");
    for out in [files.folder.path().to_str().unwrap(), "-"] {
        let ended = alone(&format!("export {toml} -o {out} --force")).await;
        ended.assert_stderr(2, &format!("{out}: name a file, FILE.html"));
    }
    let ended = alone(&format!("export No.Name -o {}.5", one.display())).await;
    ended.assert_stderr(2, "name a swarm, an experiment file");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_file_without_a_module_has_at_most_501_frames_with_the_last_state() {
    let files = Files::new();
    let toml = files.write(
        "long.toml",
        "name = 'long'\nduration = 19.98\nspec = { n = 2 }\n",
    );
    let path = files.path("long.html");
    let line = format!("export {toml} --no-engine -o {}", path.display());
    let ended = alone(&line).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let data = data(&path);
    assert_eq!(data["claim"]["steps"], 999);
    // Each second one, and the last.
    assert_eq!(data["frames"]["count"], 501);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_result_that_ended_early_is_exported_with_the_reason() {
    let files = Files::new();
    let results = executed(&files, &Plan::parse(EARLY).unwrap(), "1");
    let path = files.path("early.html");
    let line = format!(
        "export {} -o {} {}",
        results.display(),
        path.display(),
        files.wasm
    );
    let ended = alone(&line).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let claim = &data(&path)["claim"];
    assert_eq!(claim["steps"], 10);
    assert!(claim["fault"].is_string(), "{claim}");
    let ended = checked(&path).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    assert!(ended.stdout.contains("(ended early: "), "{ended:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn the_frames_of_a_run_that_ends_early_end_with_its_last_state() {
    let files = Files::new();
    let toml = files.write("early.toml", EARLY);
    let path = files.path("early.html");
    let line = format!("export {toml} --no-engine -o {}", path.display());
    let ended = alone(&line).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let data = data(&path);
    assert_eq!(data["claim"]["steps"], 10);
    // Those of steps 0, 4, 8 and 10.
    assert_eq!(data["frames"]["count"], 4);
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_of_a_run_that_ends_otherwise_than_its_result_are_not_exported() {
    let toml = "name = 'order'\nduration = 1\nspec = { n = 3 }\n";
    let files = Files::new();
    let results = executed(&files, &Plan::parse(toml).unwrap(), "1");
    let list = results.join("runs.jsonl");
    let text = fs::read_to_string(&list).unwrap();
    let (before, hash) = text.split_once("\"state_hash\":\"").unwrap();
    let altered = format!(
        "{before}\"state_hash\":\"{}{}",
        "ab".repeat(32),
        &hash[64..]
    );
    fs::write(&list, altered).unwrap();
    let path = files.path("order.html");
    let line = format!(
        "export {} --no-engine -o {}",
        results.display(),
        path.display()
    );
    let ended = alone(&line).await;
    ended.assert_stderr(1, "the run ends after 50 steps: ");
    ended.assert_stderr(1, "and not after 50 steps: abab");
    // `jostle verify` is for swarms.
    ended.assert_stderr(1, "export its experiment.toml");
    assert!(!path.exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn the_bodies_of_a_recording_have_their_shape_again_after_a_reset() {
    let (daemon, files) = (Daemon::start().await, Files::new());
    daemon
        .said("create school --n 6 --seed 3 --publish-every 1")
        .await;
    let recording = files.path("school.mcap").display().to_string();
    let recording_line = daemon.begin(&format!("record school -o {recording}"));
    daemon.until_recording().await;
    for line in [
        "step school 3",
        "set school pi1=3",
        "step school 3",
        "reset school",
        "step school 3",
    ] {
        daemon.said(line).await;
    }
    recording_line.interrupt();
    let ended = recording_line.end().await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    // A playback has no commands: its file is to be exported.
    daemon.said(&format!("replay {recording} --as shown")).await;
    let path = files.path("school.html");
    let refusal = daemon
        .refusal(&format!("export shown -o {}", path.display()))
        .await;
    let message = refusal["message"].as_str().unwrap();
    assert!(message.contains("`jostle export FILE.mcap`"), "{message}");
    daemon.stop().await;
    let ended = alone(&format!("export {recording} -o {}", path.display())).await;
    assert_eq!(ended.code, Some(0), "{ended:?}");
    let pi1 = data(&path)["frames"]["pi1"].clone();
    let ratios: Vec<_> = pi1.as_array().unwrap().iter().map(|it| &it[1]).collect();
    assert_eq!(ratios, [4.0, 3.0, 4.0], "{pi1}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_no_whole_file_of_this_model_is_not_checked() {
    let files = Files::new();
    let html = claimed("name = 'order'\nreplicates = 2\nduration = 1\n[spec]\nn = 4\n");
    let later = html.replacen("\"model_version\":", "\"model_version\":9", 1);
    for (text, problem) in [
        (
            "<!doctype html><html></html>\n",
            "not a file of `jostle export`",
        ),
        ("", "not a file of `jostle export`"),
        (&html[..html.len() - 3], "the file ends early"),
        (&html[..html.len() / 2], "the file ends early"),
        (&html.replacen("n = 4", "n = 0", 1), "n = 0 is outside"),
        (
            &html.replacen("\"index\":1", "\"index\":7", 1),
            "no run \"#1\" with the number 8",
        ),
        (&later, "check it with jostle 0.1.0"),
        (
            &html.replacen("\"format\":1", "\"format\":2", 1),
            "the file has format 2",
        ),
    ] {
        let path = files.write("file.html", text);
        alone(&format!("check {path}"))
            .await
            .assert_stderr(2, problem);
    }
    checked(&files.path("nothing.html"))
        .await
        .assert_stderr(2, "No such file");
    checked(files.folder.path())
        .await
        .assert_stderr(2, "directory");
}
