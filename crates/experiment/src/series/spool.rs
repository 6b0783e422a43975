//! The spools of the series of a run that is executed, and the files that they become.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, BufReader, Read as _, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::log::{SeriesLog, decode};
use super::{MAX_INLINE, SeriesKind};
use crate::disk::DiskWatch;
use crate::folder::FolderError;
use crate::folder::error::io_error;
use crate::plan::{Plan, PlannedRun};
use crate::run::RunCheckpoint;
use crate::spool_hash::SpoolHash;
use crate::trajectory::remove_spools_in;

/// Held while a spool is converted, which takes the memory of a row group: that of one run at a time.
static CONVERTING: Mutex<()> = Mutex::new(());

/// Records the series of a run that is executed. Its spools are opened once they have rows.
pub struct SeriesRecording {
    folder: PathBuf,
    index: usize,
    spools: RefCell<Spools>,
}

struct Spools {
    files: [Option<File>; 2],
    /// The bytes of the rows in each.
    lengths: [u64; 2],
    hashes: [SpoolHash; 2],
    /// The first error of writing one.
    written: io::Result<()>,
}

impl SeriesRecording {
    /// Begins to record a run in a folder of results, by its index in the plan, or continues after a
    /// checkpoint, which is dropped if a spool lacks rows before it or is damaged.
    pub fn of(folder: &Path, index: usize, checkpoint: &mut Option<RunCheckpoint>) -> Self {
        let (mut lengths, mut hashes) = <([u64; 2], [SpoolHash; 2])>::default();
        if let Some(read) = checkpoint {
            let stored = &read.hashes.rows;
            let mut has_rows = |(kind, log): (SeriesKind, &SeriesLog)| {
                if log.passed() == 0 {
                    return true;
                }
                let hash = SpoolHash::of(&kind.spool(folder, index), log.passed());
                let stored = stored[kind as usize].as_ref();
                let Some(hash) = hash.ok().flatten().filter(|hash| hash.is(stored)) else {
                    return false;
                };
                lengths[kind as usize] = log.passed();
                hashes[kind as usize] = hash;
                true
            };
            if !read.logs().all(&mut has_rows) {
                *checkpoint = None;
                (lengths, hashes) = Default::default();
            }
        }
        Self {
            folder: folder.to_owned(),
            index,
            spools: RefCell::new(Spools {
                files: [None, None],
                lengths,
                hashes,
                written: Ok(()),
            }),
        }
    }

    /// Returns the bytes of the rows in the spools.
    pub fn length(&self) -> u64 {
        self.spools.borrow().lengths.iter().sum()
    }

    /// Appends rows to a spool, after earlier ones of so many bytes. After an error nothing more is
    /// written.
    pub fn add(&self, kind: SeriesKind, rows: &[u8], earlier: u64) {
        let Spools {
            files,
            lengths,
            hashes,
            written,
        } = &mut *self.spools.borrow_mut();
        if written.is_ok() {
            *written = self.append(&mut files[kind as usize], kind, rows, earlier);
            lengths[kind as usize] = earlier + rows.len() as u64;
            let hash = &mut hashes[kind as usize];
            if earlier == 0 {
                // The run has started again.
                *hash = SpoolHash::default();
            }
            hash.add(rows);
        }
    }

    fn append(
        &self,
        file: &mut Option<File>,
        kind: SeriesKind,
        rows: &[u8],
        earlier: u64,
    ) -> io::Result<()> {
        let file = match file {
            Some(file) => file,
            None => {
                fs::create_dir_all(self.folder.join(kind.folder()))?;
                let mut options = OpenOptions::new();
                let options = options.create(true).truncate(false).write(true);
                let mut opened = options.open(kind.spool(&self.folder, self.index))?;
                opened.set_len(earlier)?;
                opened.seek(SeekFrom::End(0))?;
                file.insert(opened)
            }
        };
        file.write_all(rows)
    }

    /// Returns the hashes of the rows in the spools.
    pub fn hashes(&self) -> [Option<String>; 2] {
        let Spools { hashes, .. } = &*self.spools.borrow();
        hashes.each_ref().map(|hash| Some(hash.hex()))
    }

    /// Returns whether rows could not be written.
    pub fn has_failed(&self) -> bool {
        self.spools.borrow().written.is_err()
    }

    /// Makes the rows in the spools durable.
    pub fn sync(&self) {
        let Spools { files, written, .. } = &mut *self.spools.borrow_mut();
        for file in files.iter().flatten() {
            if written.is_ok() {
                *written = file.sync_data();
            }
        }
    }

    /// Ends the recording of a run that is finished: writes the files of its long series. Returns the
    /// paths of the files within the folder of results, each with its length; none if the disk space
    /// ended before.
    ///
    /// # Errors
    ///
    /// [`FolderError`] if one cannot be written, or rows could not.
    pub fn finish(
        self,
        plan: &Plan,
        run: &PlannedRun,
        has_row: bool,
        disk: Option<&DiskWatch>,
    ) -> Result<Option<BTreeMap<String, u64>>, FolderError> {
        self.check()?;
        let mut written = BTreeMap::new();
        let Spools {
            files,
            lengths,
            hashes,
            ..
        } = self.spools.into_inner();
        for (kind, file) in SeriesKind::ALL.into_iter().zip(files) {
            if file.is_none() || !has_row {
                continue;
            }
            let length = lengths[kind as usize];
            let name = kind.file(self.index);
            let target = self.folder.join(&name);
            let spool = kind.spool(&self.folder, self.index);
            let is_whole = hashes[kind as usize].check(&spool);
            is_whole.map_err(|source| io_error(&spool, source))?;
            let mut copied = 0;
            let has_room = |bytes| {
                copied += bytes;
                disk.is_none_or(|disk| disk.add(bytes))
            };
            let is_written = convert(&spool, &target, (kind, plan, run), has_room)?;
            if let Some(disk) = disk {
                disk.remove(copied);
            }
            if !is_written {
                return Ok(None);
            }
            let bytes = fs::metadata(&target).map(|it| it.len());
            let bytes = bytes.map_err(|source| io_error(&target, source))?;
            if let Some(disk) = disk {
                // The spool is removed once the run counts as finished.
                disk.remove(length);
                disk.add(bytes);
            }
            written.insert(name, bytes);
        }
        Ok(Some(written))
    }

    /// Returns the error of rows that could not be written.
    ///
    /// # Errors
    ///
    /// [`FolderError::Io`].
    pub fn check(&self) -> Result<(), FolderError> {
        let written = &self.spools.borrow().written;
        written.as_ref().copied().map_err(|error| {
            let source = io::Error::new(error.kind(), error.to_string());
            io_error(&self.folder, source)
        })
    }
}

/// Removes the spools of a run, if there are any. One that cannot be removed does no harm.
pub fn remove_spools_of(folder: &Path, index: usize) {
    for kind in SeriesKind::ALL {
        let _ = fs::remove_file(kind.spool(folder, index));
    }
}

/// Removes the spools of runs that `is_unused`, by their index in the plan, and files that were being
/// written when a process was killed.
pub fn remove_spools(folder: &Path, is_unused: impl Fn(usize) -> bool) {
    for kind in SeriesKind::ALL {
        remove_spools_in(&folder.join(kind.folder()), &is_unused);
    }
}

/// Writes the rows of a spool as the file of a run. Calls `has_room` with the bytes of some rows at a
/// time; if it returns false, there is no file and the result is false.
fn convert(
    spool: &Path,
    target: &Path,
    (kind, plan, run): (SeriesKind, &Plan, &PlannedRun),
    mut has_room: impl FnMut(u64) -> bool,
) -> Result<bool, FolderError> {
    let _alone = CONVERTING.lock().unwrap_or_else(PoisonError::into_inner);
    let fail = |source| io_error(spool, source);
    let width = 8 * (1 + kind.measures(plan).len());
    let mut file = BufReader::new(File::open(spool).map_err(fail)?);
    let removed = jostle_atomic_file::remove_unfinished(target);
    removed.map_err(|source| io_error(target, source))?;
    let mut writer = kind.begin(target, plan)?;
    let mut bytes = Vec::new();
    loop {
        bytes.clear();
        let limit = (MAX_INLINE / width as u64).max(1) * width as u64;
        let read = file.by_ref().take(limit).read_to_end(&mut bytes);
        if read.map_err(fail)? == 0 {
            break;
        }
        if !has_room(bytes.len() as u64) {
            return Ok(false);
        }
        writer.append(&decode(&bytes, kind, plan, run))?;
    }
    writer.finish()?;
    Ok(true)
}
