//! Tests of the folder: reopening, truncated and damaged files, locks.

use jostle_results::table;

use super::*;
use crate::run::execute_run;

const FILE: &str = "name = \"a\"\nduration = 1\nreplicates = 4\nspec = { n = 3 }\n\
                    measure = { order_every = 10 }\n";

struct Fixture {
    directory: tempfile::TempDir,
    plan: Plan,
}

impl Fixture {
    fn new() -> Self {
        Self {
            directory: tempfile::tempdir().unwrap(),
            plan: Plan::parse(FILE).unwrap(),
        }
    }

    fn path(&self) -> &Path {
        self.directory.path()
    }

    fn open(&self) -> Result<Folder, FolderError> {
        Folder::open(self.path(), &self.plan)
    }

    fn append(&self, folder: &mut Folder, index: usize) {
        let finished = execute_run(&self.plan, &self.plan.runs()[index], |_| true).unwrap();
        folder.append(&self.plan, vec![(index, finished)]).unwrap();
    }

    fn names(&self, folder: &Folder) -> Vec<String> {
        let rows = folder.rows().into_iter();
        rows.map(|row| row.run).collect()
    }

    fn read(&self) -> FinishedRuns {
        Folder::read(self.path(), &self.plan).unwrap()
    }

    fn order(&self, index: usize) -> Result<Series, FolderError> {
        let of = (index, SeriesKind::Order);
        Folder::read_series(self.path(), &self.plan, &self.read(), of)
    }

    fn series(&self, index: usize) -> Result<Series, FolderError> {
        let of = (index, SeriesKind::Measures);
        Folder::read_series(self.path(), &self.plan, &self.read(), of)
    }

    /// Applies `change` to the bytes of the list of finished runs.
    fn edit(&self, change: impl FnOnce(&mut Vec<u8>)) {
        let path = self.path().join(RUNS);
        let mut bytes = fs::read(&path).unwrap();
        change(&mut bytes);
        fs::write(path, bytes).unwrap();
    }
}

#[test]
fn a_reopened_folder_returns_rows_in_plan_order_with_their_series() {
    let fixture = Fixture::new();
    let mut folder = fixture.open().unwrap();
    for index in [2, 0] {
        fixture.append(&mut folder, index);
    }
    assert_eq!(fixture.names(&folder), ["#0", "#2"]);
    let rows = folder.rows();
    drop(folder);
    let folder = fixture.open().unwrap();
    assert_eq!(folder.rows(), rows);
    assert_eq!(fixture.read().rows, rows);
    let finished = (0..4).map(|index| folder.is_finished(index));
    assert_eq!(finished.collect::<Vec<_>>(), [true, false, true, false]);
    folder.write_tables(&fixture.plan).unwrap();
    assert_eq!(table::read(fixture.path()).unwrap(), rows);
    let series = table::series::read(&fixture.path().join(ORDER_NAME)).unwrap();
    let expected = [0, 2].map(|index| {
        let run = &fixture.plan.runs()[index];
        execute_run(&fixture.plan, run, |_| true)
            .unwrap()
            .order
            .unwrap()
    });
    assert_eq!(series, expected);
    for (index, expected) in [0, 2].into_iter().zip(expected) {
        let order = fixture.order(index).unwrap();
        assert_eq!(order, expected);
    }
    assert!(fixture.order(1).is_err());
}

#[test]
fn measures_over_time_are_read_back_and_written_as_a_table() {
    let columns = "columns = [\"order\", \"drift\", \"msd(0.2)\"], series_every = 20, from = 0.5";
    let fixture = Fixture {
        plan: Plan::parse(&FILE.replace("order_every = 10", columns)).unwrap(),
        ..Fixture::new()
    };
    let mut folder = fixture.open().unwrap();
    for index in [3, 1] {
        fixture.append(&mut folder, index);
    }
    let expected = [1, 3].map(|index| {
        let run = &fixture.plan.runs()[index];
        execute_run(&fixture.plan, run, |_| true)
            .unwrap()
            .series
            .unwrap()
    });
    // 50 steps: the last state is not of a multiple of 20.
    assert_eq!(expected[0].steps, [0, 20, 40, 50]);
    let names: Vec<&str> = expected[0]
        .measures
        .iter()
        .map(|it| it.name.as_str())
        .collect();
    assert_eq!(names, ["order", "drift", "msd(0.2)"]);
    assert_eq!(
        expected[0].measures[1].values, [None; 4],
        "no individual is informed"
    );
    assert_eq!(expected[0].measures[2].values[0], None, "no earlier state");
    assert!(expected[0].measures[2].values[1].unwrap() > 0.0);
    for (index, expected) in [1, 3].into_iter().zip(&expected) {
        assert_eq!(fixture.series(index).unwrap(), *expected);
    }
    assert!(fixture.series(0).is_err() && fixture.order(1).is_err());
    folder.write_tables(&fixture.plan).unwrap();
    let table = table::series::read(&fixture.path().join(SERIES_NAME)).unwrap();
    assert_eq!(table, expected);
    assert!(!fixture.path().join(ORDER_NAME).exists());
}

#[test]
fn tables_without_a_run_have_all_columns() {
    let text = "name = \"a\"\nduration = 1\n[spec]\nn = 3\n[measure]\ncolumns = [\"order\"]\n\
                [[grid]]\nlimit = [-2, -3]\n[stop]\nwhen = \"order > $limit\"\n";
    let fixture = Fixture {
        plan: Plan::parse(text).unwrap(),
        ..Fixture::new()
    };
    let mut folder = fixture.open().unwrap();
    for index in [0, 1] {
        fixture.append(&mut folder, index);
    }
    assert!(folder.rows().is_empty());
    folder.write_tables(&fixture.plan).unwrap();
    let csv = fs::read_to_string(fixture.path().join(CSV_NAME)).unwrap();
    assert!(
        csv.ends_with(",state_hash,limit,stopped_at,order\n"),
        "{csv}"
    );
    let rows = table::read(&fixture.path().join(PARQUET_NAME)).unwrap();
    assert!(rows.is_empty());
}

#[test]
fn series_that_earlier_versions_stored_in_files_are_read() {
    for (grid, has_drift) in [("", false), ("[[grid]]\ninformed = 1\n", true)] {
        read_stored_series(&format!("{FILE}{grid}"), has_drift);
    }
}

fn read_stored_series(plan: &str, has_drift: bool) {
    let fixture = Fixture {
        plan: Plan::parse(plan).unwrap(),
        ..Fixture::new()
    };
    let mut folder = fixture.open().unwrap();
    fixture.append(&mut folder, 1);
    drop(folder);
    let order = fixture.order(1).unwrap();
    let [orders, drifts] = [0, 1].map(|column| {
        let values = order.measures[column].values.iter();
        values.flatten().copied().collect::<Vec<f64>>()
    });
    assert_eq!(
        (orders.len(), drifts.len()),
        (6, if has_drift { 6 } else { 0 })
    );
    // The line and the file as earlier versions wrote them.
    fixture.edit(|bytes| {
        let text = String::from_utf8(bytes.clone()).unwrap();
        let lines = text.lines().map(|line| {
            let mut line: serde_json::Value = serde_json::from_str(line).unwrap();
            line.as_object_mut().unwrap().remove("order");
            format!("{line}\n")
        });
        *bytes = lines.collect::<String>().into_bytes();
    });
    assert!(fixture.order(1).is_err());
    fs::create_dir(fixture.path().join(RAW)).unwrap();
    let numbers = orders.iter().chain(&drifts);
    let bytes: Vec<u8> = numbers.flat_map(|number| number.to_le_bytes()).collect();
    fs::write(fixture.path().join("order/000001"), bytes).unwrap();
    let stored = fixture.order(1).unwrap();
    assert_eq!(stored, order);
    let folder = fixture.open().unwrap();
    folder.write_tables(&fixture.plan).unwrap();
    let table = table::series::read(&fixture.path().join(ORDER_NAME)).unwrap();
    assert_eq!(table, [order]);
}

#[test]
fn an_incomplete_last_line_is_dropped_and_earlier_runs_are_kept() {
    let fixture = Fixture::new();
    let mut folder = fixture.open().unwrap();
    let header = fs::read(fixture.path().join(RUNS)).unwrap().len();
    fixture.append(&mut folder, 0);
    let first = fs::read(fixture.path().join(RUNS)).unwrap().len();
    fixture.append(&mut folder, 1);
    drop(folder);
    let whole = fs::read(fixture.path().join(RUNS)).unwrap();
    for length in (0..whole.len())
        .step_by(7)
        .chain([header, first, whole.len() - 1])
    {
        fixture.edit(|bytes| *bytes = whole[..length].to_vec());
        let folder = fixture.open().unwrap();
        let expected = usize::from(length >= first);
        assert_eq!(fixture.names(&folder).len(), expected, "{length}");
        let left = fs::read(fixture.path().join(RUNS)).unwrap();
        assert_eq!(left.len(), if expected == 1 { first } else { header });
    }
    // A last line of zero bytes, as a file system may leave after a crash, is dropped too.
    fixture.edit(|bytes| *bytes = [&whole[..first], b"\0\0\0\0\n"].concat());
    assert_eq!(fixture.names(&fixture.open().unwrap()), ["#0"]);
}

#[test]
fn a_damaged_line_is_reported_and_the_file_is_unchanged() {
    let fixture = Fixture::new();
    let mut folder = fixture.open().unwrap();
    fixture.append(&mut folder, 0);
    fixture.append(&mut folder, 1);
    drop(folder);
    let whole = fs::read(fixture.path().join(RUNS)).unwrap();
    let text = String::from_utf8(whole).unwrap();
    let lines: Vec<&str> = text.split_inclusive('\n').collect();
    let seed = fixture.plan.runs()[0].seed.to_string();
    for damaged in [
        [lines[0], &lines[1][5..], lines[2]].concat(),
        [lines[0], &lines[1].replace("#0", "#9"), lines[2]].concat(),
        [lines[0], &lines[1].replace(&seed, "1"), lines[2]].concat(),
    ] {
        fixture.edit(|bytes| *bytes = damaged.clone().into_bytes());
        match fixture.open().unwrap_err() {
            FolderError::Damaged { line, .. } => assert_eq!(line, 2),
            other => panic!("{other}"),
        }
        assert_eq!(
            fs::read_to_string(fixture.path().join(RUNS)).unwrap(),
            damaged
        );
    }
    let old = lines
        .concat()
        .replace("\"model_version\":", "\"model_version\":9");
    fixture.edit(|bytes| *bytes = old.into_bytes());
    let other = fixture.open().unwrap_err();
    assert!(matches!(other, FolderError::OtherModel { .. }), "{other}");
}

#[test]
fn a_folder_has_one_experiment_and_one_writer() {
    let fixture = Fixture::new();
    let folder = fixture.open().unwrap();
    let twice = fixture.open().unwrap_err();
    assert!(matches!(twice, FolderError::InUse { .. }), "{twice}");
    drop(folder);
    let other = Plan::parse(&format!("{FILE}# another\n")).unwrap();
    let rejected = Folder::open(fixture.path(), &other).unwrap_err();
    assert!(
        matches!(rejected, FolderError::OtherExperiment { .. }),
        "{rejected}"
    );
    fixture.open().unwrap();
    fs::remove_file(fixture.path().join(EXPERIMENT)).unwrap();
    let orphan = fixture.open().unwrap_err();
    assert!(
        matches!(orphan, FolderError::NoExperiment { file: RUNS, .. }),
        "{orphan}"
    );
    let file = fixture.path().join(RUNS);
    let not_a_folder = Folder::open(&file, &fixture.plan).unwrap_err();
    assert!(
        matches!(not_a_folder, FolderError::Io { .. }),
        "{not_a_folder}"
    );
}

/// Names the folder in the child process of the test below.
#[cfg(unix)]
const LIMITED: &str = "JOSTLE_TEST_LIMITED_FOLDER";

/// A process that may write files of 32 or 64 KiB only, as the units of `sh` are, appends a line that
/// is longer, then a short one.
#[cfg(unix)]
#[test]
fn a_line_that_is_written_in_part_is_replaced_by_the_next_one() {
    let fixture = Fixture::new();
    if let Some(path) = std::env::var_os(LIMITED) {
        let mut folder = Folder::open(Path::new(&path), &fixture.plan).unwrap();
        let run = |index: usize| execute_run(&fixture.plan, &fixture.plan.runs()[index], |_| true);
        fixture.append(&mut folder, 0);
        let mut finished = run(1).unwrap();
        if let Some(series) = &mut finished.order {
            series.steps = vec![0; 10_000];
            series.measures[0].values = vec![Some(1.0 / 3.0); 10_000];
        }
        let failed = folder.append(&fixture.plan, vec![(1, finished)]);
        assert!(matches!(failed, Err(FolderError::Io { .. })), "{failed:?}");
        assert!(!folder.is_finished(1));
        fixture.append(&mut folder, 2);
        return;
    }
    let limited = std::process::Command::new("sh")
        .args(["-c", "trap '' XFSZ; ulimit -f 64; exec \"$0\" \"$@\""])
        .arg(std::env::current_exe().unwrap())
        .args([
            "--exact",
            "folder::tests::a_line_that_is_written_in_part_is_replaced_by_the_next_one",
        ])
        .env(LIMITED, fixture.path())
        .output()
        .unwrap();
    let output = String::from_utf8_lossy(&limited.stdout);
    assert!(limited.status.success(), "{output}");
    assert!(output.contains("1 passed"), "{output}");
    let folder = fixture.open().unwrap();
    assert_eq!(fixture.names(&folder), ["#0", "#2"]);
    folder.write_tables(&fixture.plan).unwrap();
}

#[test]
fn the_folder_of_an_unfinished_one_is_known() {
    for (output, label) in [("results", "1-of-2"), ("a/b.c", "runs-0123abcd")] {
        let path = unfinished(Path::new(output), label);
        assert_eq!(finished(&path), Path::new(output));
    }
    for path in ["results", "a/.hidden.part", ".jostle-results"] {
        assert_eq!(finished(Path::new(path)), Path::new(path));
    }
}
