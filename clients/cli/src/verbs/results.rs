//! `results`: tables of experiments on this machine. Needs no daemon.

use std::io::ErrorKind;
use std::num::NonZero;
use std::thread;
use std::time::{SystemTime, UNIX_EPOCH};

use jostle_experiment::{FolderError, MergeError, Parts};
use jostle_results::table::TableError;
use serde_json::json;

use crate::arguments::{MergeArguments, Results};
use crate::failure::Failure;
use crate::format;
use crate::output::Output;
use crate::progress;

pub fn results(output: Output, what: &Results) -> Result<(), Failure> {
    match what {
        Results::Merge(arguments) => merge(output, arguments),
    }
}

fn merge(output: Output, arguments: &MergeArguments) -> Result<(), Failure> {
    Parts::check_target(&arguments.out).map_err(failure)?;
    let parts = Parts::read(&arguments.parts).map_err(failure)?;
    let verified = match arguments.verify {
        Some(share) => verify(output, &parts, share, arguments.threads)?,
        None => 0,
    };
    let folder = parts.write(&arguments.out).map_err(failure)?;
    let (runs, count) = (parts.plan().runs().len(), parts.count());
    let document =
        json!({"runs": runs, "parts": count, "verified": verified, "folder": folder.path()});
    let mut text = format!(
        "merged {} from {} into {}",
        format::count(runs as u64, "run"),
        format::count(count as u64, "part"),
        folder.path().display()
    );
    if verified > 0 {
        let verified = format::count(verified as u64, "run");
        text += &format!("; executed {verified} again, with the same results");
    }
    output.print(&document, &text)
}

/// Executes a share of the runs again and returns their number.
fn verify(
    output: Output,
    parts: &Parts,
    share: f64,
    threads: Option<NonZero<usize>>,
) -> Result<usize, Failure> {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH);
    let nanos = since_epoch.map_or(0, |it| it.subsec_nanos());
    let subset = parts.sample(
        share,
        u64::from(nanos) << 32 | u64::from(std::process::id()),
    );
    let cores = || thread::available_parallelism().unwrap_or(NonZero::<usize>::MIN);
    let threads = threads.unwrap_or_else(cores).get();
    let count = subset.indices().len();
    let template = "verify {bar:30} {pos} of {len} runs";
    let bar = progress::bar(output, Some(count as u64), template, "");
    let verified = parts.verify(&subset, threads, |done| bar.set_position(done as u64));
    bar.finish_and_clear();
    verified.map_err(failure)?;
    Ok(count)
}

/// Converts an error of merging.
#[expect(clippy::needless_pass_by_value, reason = "`map_err` passes it")]
pub fn failure(error: MergeError) -> Failure {
    let system = match &error {
        MergeError::Folder(
            FolderError::Io { source, .. } | FolderError::Table(TableError::Io { source, .. }),
        ) => Some(source.kind()),
        _ => None,
    };
    let code = match (&error, system) {
        (MergeError::Differs { .. }, _) => "mismatch",
        (MergeError::Exists { .. }, _) => "already_exists",
        (MergeError::Folder(FolderError::InUse { .. }), _) => "conflict",
        (error, _) if error.other_model().is_some() => "conflict",
        (_, Some(ErrorKind::StorageFull | ErrorKind::QuotaExceeded)) => "storage_full",
        (_, Some(ErrorKind::NotFound)) => "not_found",
        (MergeError::Folder(FolderError::NoResults { .. }), _) => "not_found",
        (_, Some(ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem)) => {
            "permission_denied"
        }
        (_, Some(_)) => "internal",
        _ => "invalid_argument",
    };
    let failure = Failure::new(code, error.to_string());
    match error.other_model() {
        Some(version) => failure.with("model_version", version),
        None => failure,
    }
}
