//! `claims --bands`: means outside their bands have an exit code of their own.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const RESULTS: &str = "\
run,seed,n,pi1,pi2,pi3,pi4,informed,contacts,dt,time,v,v_pd,ordered_intervals,ordered_time,\
unordered_intervals,unordered_time,worst_overlap,crossed_share,worst_residual,degraded,fallbacks,\
steps,state_hash
one,1,10,4,1,1,10,0,endpoints,0.02,100,0.25,,1,50,1,50,0,0,1e-9,0,0,5000,00
two,2,10,4,1,1,10,0,endpoints,0.02,100,0.35,,1,50,1,50,0,0,1e-9,0,0,5000,01
";

/// Results of two runs, as an experiment writes them, whose `v` is 0.25 and 0.35.
fn results(folder: &Path) -> PathBuf {
    let place = folder.join("results");
    fs::create_dir(&place).unwrap();
    fs::write(place.join("results.csv"), RESULTS).unwrap();
    place
}

#[test]
fn runs_that_are_shorter_than_those_of_the_paper_are_noted() {
    let folder = tempfile::tempdir().unwrap();
    let ended = Command::new(env!("CARGO_BIN_EXE_jostle"))
        .arg("claims")
        .arg(results(folder.path()))
        .output()
        .unwrap();
    let said = String::from_utf8(ended.stderr).unwrap();
    let note = "2 of 2 runs are shorter than the paper's 1000 time units";
    assert!(ended.status.success() && said.contains(note), "{said}");
}

fn judge(results: &Path, bands: &str) -> (Option<i32>, String) {
    let file = results.with_file_name("bands.csv");
    fs::write(&file, format!("quantity,pi1,n,low,high\n{bands}")).unwrap();
    let Output { status, stderr, .. } = Command::new(env!("CARGO_BIN_EXE_jostle"))
        .arg("claims")
        .arg(results)
        .arg("--bands")
        .arg(file)
        .output()
        .unwrap();
    (status.code(), String::from_utf8(stderr).unwrap())
}

#[test]
fn only_means_outside_their_bands_end_with_code_9() {
    let folder = tempfile::tempdir().unwrap();
    let results = results(folder.path());
    let (code, said) = judge(&results, "v,4,10,0.29,0.31\n");
    assert_eq!(code, Some(0), "{said}");
    let (code, said) = judge(&results, "v,4,10,0.29,0.31\nv,4,10,0.31,0.33\n");
    assert_eq!(code, Some(9), "{said}");
    assert!(
        said.contains("1 of 2 means lie outside their bands"),
        "{said}"
    );
    // Nothing was measured: that is no mean outside its band.
    let (code, said) = judge(&results, "v,4,10,0.31,0.33\nv,4,30,0.29,0.31\n");
    assert_eq!(code, Some(2), "{said}");
    assert!(
        said.contains("for 1 of 2 bands the results have no run"),
        "{said}"
    );
    for (bands, reason) in [
        ("", "no band"),
        ("w,4,10,0.29,0.31\n", "no quantity is called w"),
    ] {
        let (code, said) = judge(&results, bands);
        assert_eq!(code, Some(2), "{said}");
        assert!(said.contains(reason), "{said}");
    }
    let (code, said) = judge(&folder.path().join("nothing"), "v,4,10,0.29,0.31\n");
    assert_eq!(code, Some(2), "{said}");
}
