//! Where all runs of an experiment are executed again, beside those that another version of the model
//! executed.

use std::fs;
use std::path::{Path, PathBuf};

use jostle_physics::model::MODEL_VERSION;

/// Returns the name of an experiment that is executed again under this version of the model.
#[must_use]
pub fn name_again(name: &str) -> String {
    format!("{name}{}", suffix())
}

/// Returns the folder of results that are computed again, beside `folder`.
#[must_use]
pub fn folder_again(folder: &Path) -> PathBuf {
    // A folder such as `.` has a name only as an absolute path.
    let named = match folder.file_name() {
        Some(_) => folder.to_owned(),
        None => fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned()),
    };
    let mut name = named.file_name().unwrap_or_default().to_owned();
    name.push(suffix());
    named.with_file_name(name)
}

fn suffix() -> String {
    format!("-model{MODEL_VERSION}")
}

#[cfg(test)]
mod tests {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt as _;

    use super::*;

    #[test]
    fn a_folder_keeps_its_name_and_the_present_one_gets_its_own() {
        for (folder, again) in [
            (&b"a/results"[..], &b"a/results-model"[..]),
            (b"a/b.c", b"a/b.c-model"),
            (b"a/\xff", b"a/\xff-model"),
        ] {
            let mut expected = OsStr::from_bytes(again).to_owned();
            expected.push(MODEL_VERSION.to_string());
            let folder = Path::new(OsStr::from_bytes(folder));
            assert_eq!(folder_again(folder), Path::new(&expected));
        }
        // The tests of a package are executed in its folder.
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let here = fs::canonicalize(here).map(|it| folder_again(&it)).ok();
        assert_eq!(Some(folder_again(Path::new("."))), here);
    }
}
