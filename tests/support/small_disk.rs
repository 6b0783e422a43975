//! A disk of a few megabytes, to be filled.

use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use super::needs;

/// A disk of its own, as small as this.
pub struct SmallDisk(
    PathBuf,
    #[expect(dead_code, reason = "held for its end")] tempfile::TempDir,
);

impl SmallDisk {
    /// A disk of this size. Where the machine permits no mount, the test fails or may be skipped.
    #[track_caller]
    pub fn mount(megabytes: u64) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let size = format!("size={megabytes}m");
        let path = folder.path().to_owned();
        let mount = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &size, "none"])
            .arg(&path)
            .output();
        if mount.is_ok_and(|mount| mount.status.success()) {
            return Some(SmallDisk(path, folder));
        }
        needs::MOUNT.is_missing();
        None
    }

    pub fn path(&self) -> &Path {
        &self.0
    }

    /// Changes its size.
    pub fn resize(&self, megabytes: u64) {
        let size = format!("remount,size={megabytes}m");
        let mut remount = Command::new("mount");
        let status = remount.args(["-o", &size]).arg(&self.0).status();
        assert!(status.unwrap().success());
    }

    pub fn fill(&self) {
        File::create(self.0.join("ballast")).unwrap();
        self.fill_more();
    }

    /// Fills the space that others have freed since.
    pub fn fill_more(&self) {
        let mut options = File::options();
        let ballast = options.append(true).create(true);
        let mut file = ballast.open(self.0.join("ballast")).unwrap();
        for size in [65536, 4096, 1] {
            while file.write_all(&vec![0; size]).is_ok() {}
        }
    }

    pub fn make_room(&self) {
        fs::remove_file(self.0.join("ballast")).unwrap();
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}
