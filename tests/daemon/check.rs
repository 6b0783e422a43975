//! `jostled check`, and the module with which the page does the same.

use std::fs;
use std::process::{Output, Stdio};

use jostle_experiment::Plan;
use jostle_experiment::html::{Claim, ClaimedRun, Content, HtmlFile};
use serde_json::{Value, json};

use crate::support::Daemon;
use crate::support::http::{of_daemon, send_bytes};
use crate::support::process::jostled;

/// `printf '\0asm\1\0\0\0' | gzip -9n`: the least module.
const MODULE: [u8; 28] = [
    0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 2, 3, 0x63, 0x48, 0x2c, 0xce, 0x65, 0x64, 0x60, 0x60, 0, 0, 0xce,
    0x33, 0x4b, 0x1c, 8, 0, 0, 0,
];

/// `printf '\0asm\1\0\0\0\0\2\1a' | gzip -9n`: another one, with a section that has a name only.
const OTHER_MODULE: [u8; 30] = [
    0x1f, 0x8b, 0x08, 0x00, 0x00, 0x00, 0x00, 0x00, 0x02, 0x03, 0x63, 0x48, 0x2c, 0xce, 0x65, 0x64,
    0x00, 0x02, 0x26, 0xc6, 0x44, 0x00, 0x80, 0x63, 0x5d, 0xb6, 0x0c, 0x00, 0x00, 0x00,
];

/// What `sha256sum` prints of the first one, unpacked.
pub const SHA256: &str = "93a44bbb96c751218e4c00d479e4c14358122a389acca16205b1e4d0dc5f9476";

/// A page with the places that a player has.
const PLAYER: &str = "<title>{{jostle:title}}</title><script type=\"application/json\" \
    id=\"jostle-file\">{{jostle:file}}</script>{{jostle:module}}</html>";

/// What `sha256sum` prints of the other one, unpacked.
pub const OTHER_SHA256: &str = "ad7e07012b3bc61e217e1dddbba916d27799bc198c2f1d066a4562dd22513734";

/// Writes the modules of these tests: `jostle.wasm.gz` and `other.wasm.gz`.
pub fn write_modules(folder: &std::path::Path) {
    fs::write(folder.join("jostle.wasm.gz"), MODULE).unwrap();
    fs::write(folder.join("other.wasm.gz"), OTHER_MODULE).unwrap();
}

/// The text of a file with a run of three individuals.
pub fn claimed() -> String {
    let plan = Plan::parse("name = 'order'\nduration = 1\nspec = { n = 3 }\n").unwrap();
    let run = &plan.runs()[0];
    let claim = Claim::of(&plan, run, |_| true).unwrap().unwrap();
    let run = ClaimedRun::new(&plan, run, claim);
    let file = HtmlFile::new("order".to_owned(), "", Content::Run(Box::new(run)));
    file.fill(PLAYER, None).unwrap()
}

#[test]
fn a_file_is_checked_without_a_daemon() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("order.html");
    let check = |html: &str, options: &[&str]| {
        fs::write(&path, html).unwrap();
        let line = [&["check", path.to_str().unwrap()], options].concat();
        let (stdout, stderr) = (Stdio::piped(), Stdio::piped());
        let child = jostled(&line)
            .stdout(stdout)
            .stderr(stderr)
            .spawn()
            .unwrap();
        let Output {
            status,
            stdout,
            stderr,
        } = child.wait_with_output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        (status.code(), text(stdout), text(stderr))
    };
    let html = claimed();
    let (code, stdout, stderr) = check(&html, &[]);
    assert_eq!((code, stderr.as_str()), (Some(0), ""));
    assert!(stdout.starts_with("equal after 50 steps: "), "{stdout}");
    let altered = html.replacen("n = 3", "n = 4", 1);
    let (code, stdout, stderr) = check(&altered, &[]);
    assert_eq!((code, stderr.as_str()), (Some(1), ""));
    assert!(stdout.starts_with("different: "), "{stdout}");
    let (code, stdout, _) = check(&altered, &["--json"]);
    let checked: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!((code, &checked["equal"]), (Some(1), &json!(false)));
    assert_eq!(checked["claim"]["steps"], 50);
    let (code, stdout, stderr) = check(&html[..html.len() - 1], &[]);
    assert_eq!((code, stdout.as_str()), (Some(2), ""));
    assert!(
        stderr.contains("order.html: the file ends early"),
        "{stderr}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn the_module_is_served_with_its_hash_as_the_page_computes_it() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("jostle.wasm.gz");
    write_modules(folder.path());
    let daemon = Daemon::with(&[("wasm", path.to_str().unwrap())]).await;
    let address = of_daemon(&daemon);
    let fetch = |method: &str, headers: &str| {
        let about = format!("Host: {address}\r\nConnection: close\r\n{headers}");
        let request = format!("{method} /jostle.wasm HTTP/1.1\r\n{about}\r\n");
        let (status, head, body) = send_bytes(&address, &request);
        (status, head.to_lowercase(), body)
    };
    let hash = format!("jostle-wasm-sha256: {SHA256}\r\n");
    let (status, head, body) = fetch("GET", "Accept-Encoding: gzip\r\n");
    assert_eq!((status, &body[..]), (200, &MODULE[..]));
    for header in [
        "content-encoding: gzip\r\n",
        "content-type: application/wasm\r\n",
        &hash,
    ] {
        assert!(head.contains(header), "{header}: {head}");
    }
    let (status, head, body) = fetch("GET", "");
    assert_eq!((status, &body[..]), (200, &b"\0asm\x01\0\0\0"[..]));
    assert!(
        !head.contains("content-encoding") && head.contains(&hash),
        "{head}"
    );
    let (_, etag) = head.split_once("etag: ").unwrap();
    let known = format!("If-None-Match: {}\r\n", etag.split_once('\r').unwrap().0);
    assert_eq!(fetch("GET", &known).0, 304);
    let (status, head, body) = fetch("HEAD", "");
    assert_eq!((status, body.len()), (200, 0));
    assert!(head.contains(&hash), "{head}");
    daemon.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_may_compile_a_module_and_load_nothing_more() {
    let daemon = Daemon::start().await;
    let address = of_daemon(&daemon);
    let get = |path: &str| {
        let head = format!("GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
        let (status, head, _) = send_bytes(&address, &head);
        (status, head)
    };
    // This program has no module installed.
    assert_eq!(get("/jostle.wasm").0, 404);
    let (_, head) = get("/");
    let policy = "content-security-policy: default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; \
                  img-src 'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'; \
                  object-src 'none'\r\n";
    assert!(head.contains(policy), "{head}");
    daemon.stop().await;
}
