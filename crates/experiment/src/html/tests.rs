use std::fs;

use flate2::read::GzDecoder;
use serde_json::Value;

use super::*;

const PLAYER: &str = "<!doctype html><html><head><title>{{jostle:title}}</title></head><body>\
    <script type=\"application/json\" id=\"jostle-file\">{{jostle:file}}</script>\
    <script type=\"text/plain\" id=\"jostle-module\">{{jostle:module}}</script>\
    <script>play()</script></body></html>\n";

/// With text that would end the element of the data, or begin a comment in it.
const TOML: &str = "# </script><!-- \u{2028} & -->\nname = 'order'\nreplicates = 2\nduration = 2\n\
    [[grid]]\nn = [5]\n";

fn file() -> HtmlFile {
    let plan = Plan::parse(TOML).unwrap();
    let run = &plan.runs()[1];
    let claim = Claim::of(&plan, run, |_| true).unwrap().unwrap();
    assert_eq!(claim.steps, 100);
    let content = ClaimedRun::new(&plan, run, claim);
    let name = "a <b>".to_owned();
    HtmlFile::new(name, "MIT", Content::Run(Box::new(content)))
}

fn module(bytes: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("jostle.wasm.gz");
    let mut gzip = GzEncoder::new(Vec::new(), Compression::fast());
    gzip.write_all(bytes).unwrap();
    fs::write(&path, gzip.finish().unwrap()).unwrap();
    fs::write(folder.path().join("licences.txt"), "its licences").unwrap();
    (folder, path)
}

#[test]
fn what_is_filled_in_is_read_again_and_no_text_in_it_ends_an_element() {
    let (_folder, path) = module(b"\0asm\x01\0\0\0");
    let module = Module::read(&path).unwrap();
    assert_eq!(module.licences, "its licences");
    let html = file().fill(PLAYER, Some(&module)).unwrap();
    assert_eq!(html.matches("</script>").count(), 3, "{html}");
    assert!(!html.contains("<!--"), "{html}");
    assert!(html.contains("<title>a &lt;b&gt;</title>"), "{html}");
    let base64 = STANDARD.encode(&module.gzip);
    assert!(html.contains(&format!("id=\"jostle-module\">{base64}</script>")));
    assert_eq!(HtmlFile::parse(&html).unwrap(), file());
    assert!(
        file()
            .fill(PLAYER, None)
            .unwrap()
            .contains("module\"></script>")
    );
}

#[test]
fn the_data_have_the_members_that_the_player_reads() {
    let value = serde_json::to_value(file()).unwrap();
    let members: Vec<&String> = value.as_object().unwrap().keys().collect();
    let expected = [
        "claim",
        "files",
        "format",
        "kind",
        "licences",
        "model_version",
        "name",
        "run",
        "version",
    ];
    assert_eq!(members, expected);
    assert_eq!(value["kind"], "run");
    assert_eq!(value["run"]["index"], 1);
    assert_eq!(value["claim"]["steps"], 100);
    let licences = STANDARD
        .decode(value["licences"].as_str().unwrap())
        .unwrap();
    assert_eq!(
        io::read_to_string(GzDecoder::new(&*licences)).unwrap(),
        "MIT"
    );
    assert_eq!(value["files"]["toml"], TOML);
    let mut encoder = FrameEncoder::new(0.02);
    let frame = FrameOfBodies {
        step: 0,
        id: &[0],
        x: &[0.0],
        y: &[0.0],
        alpha: &[0.0],
        weight: &[0.0],
    };
    encoder.add(&frame, 4.0);
    let frames = encoder.finish();
    let recording = HtmlFile::new(String::new(), "", Content::Recording { frames });
    let value = serde_json::to_value(&recording).unwrap();
    assert_eq!(
        (&value["kind"], &value["frames"]["count"]),
        (&"recording".into(), &1.into())
    );
    let error = Check::of(&recording).unwrap_err();
    assert!(matches!(error, CheckError::NoClaim), "{error}");
}

#[test]
fn a_check_tells_the_equal_end_from_another() {
    let mut steps = Vec::new();
    let check = Check::of(&file()).unwrap();
    assert_eq!(check.steps(), 100);
    let checked = check
        .execute(|step| {
            steps.push(step);
            true
        })
        .unwrap();
    assert_eq!(steps.last(), Some(&100));
    assert!(checked.equal, "{checked}");
    assert!(
        checked.to_string().starts_with("equal after 100 steps: "),
        "{checked}"
    );
    let cancelled = Check::of(&file()).unwrap().execute(|_| false);
    assert!(matches!(cancelled, Err(CheckError::Cancelled)));
    let with = |change: fn(&mut ClaimedRun)| {
        let mut file = file();
        let Content::Run(run) = &mut file.content else {
            unreachable!()
        };
        change(run);
        Check::of(&file).unwrap().execute(|_| true).unwrap()
    };
    for checked in [
        with(|run| run.claim.steps = 99),
        with(|run| run.claim.state_hash.replace_range(..1, "x")),
        with(|run| run.claim.fault = Some("a fault".to_owned())),
        with(|run| run.files.toml = TOML.replace("[[grid]]", "[spec]\npi3 = 1.01\n[[grid]]")),
    ] {
        assert!(!checked.equal, "{checked}");
        assert!(checked.to_string().starts_with("different: "), "{checked}");
    }
}

#[test]
fn a_file_that_cannot_be_checked_says_why() {
    let html = file().fill(PLAYER, None).unwrap();
    let error = |html: &str| HtmlFile::parse(html).unwrap_err().to_string();
    assert!(error("<html></html>").starts_with("not a file of `jostle export`"));
    assert!(error(&html[..html.len() - 20]).contains("ends early"));
    let (start, _) = html.split_once("</script>").unwrap();
    assert!(error(&start[..start.len() - 9]).contains("ends early"));
    let head = "<!doctype html><meta name=\"generator\" content=\"jostle export\" /><style>";
    assert!(error(head).contains("ends early"));
    let later = html.replacen("\"format\":1", "\"format\":2", 1);
    assert!(error(&later).contains("format 2"), "{}", error(&later));
    let damaged = html.replacen("\"claim\":{", "\"claim\":[", 1);
    assert!(error(&damaged).contains("are damaged"));
    let mut other = file();
    other.model_version += 1;
    other.version = "9.9.9".to_owned();
    let text = Check::of(&other).unwrap_err().to_string();
    assert!(
        text.contains("version 9.9.9") || text.contains("jostle 9.9.9"),
        "{text}"
    );
    let mut other = file();
    let Content::Run(run) = &mut other.content else {
        unreachable!()
    };
    run.run.name = "n=5 #7".to_owned();
    let text = Check::of(&other).unwrap_err().to_string();
    assert!(text.contains("no run \"n=5 #7\""), "{text}");
}

#[test]
fn only_a_compressed_module_is_one() {
    let (_folder, path) = module(b"text");
    let error = Module::read(&path).unwrap_err().to_string();
    assert!(error.contains("no module compressed by gzip"), "{error}");
    fs::write(&path, b"\0asm\x01\0\0\0").unwrap();
    assert!(Module::read(&path).is_err());
    let error = Module::read(&path.with_extension("nothing")).unwrap_err();
    assert_eq!(error.source.kind(), io::ErrorKind::NotFound);
}

#[test]
fn the_page_of_a_player_has_each_place_once() {
    for wrong in [
        PLAYER.replace("{{jostle:module}}", ""),
        PLAYER.replace("play()", "{{jostle:module}}"),
        PLAYER.replace("play()", "{{jostle:file}}"),
        PLAYER.replace("<title>", "{{jostle:other}}<title>"),
    ] {
        let error = file().fill(&wrong, None).unwrap_err();
        assert!(matches!(error, HtmlError::NoPlace(_)), "{error}");
    }
    let _: Value = serde_json::from_str(&json(&file()).unwrap()).unwrap();
}

#[test]
fn numbers_are_grouped_by_three_digits() {
    for (number, text) in [
        (0, "0"),
        (999, "999"),
        (5000, "5,000"),
        (1_234_567, "1,234,567"),
    ] {
        assert_eq!(grouped(number), text);
    }
}

#[test]
fn a_file_without_an_end_is_not_read_whole() {
    let error = HtmlFile::read(Path::new("/dev/zero")).unwrap_err();
    assert_eq!(error.to_string(), "it has more than 250 MB");
}
