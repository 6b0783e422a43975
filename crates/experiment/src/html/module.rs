//! The module that steps swarms in a browser: the file in which it is.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use flate2::read::GzDecoder;
use thiserror::Error;

/// The place of the module below the folder that has `bin`.
const PLACE: &str = "share/jostle/jostle.wasm.gz";

/// The name of the file beside the module with the licences of what it contains.
const LICENCES: &str = "licences.txt";

/// The first bytes of each module.
const MAGIC: [u8; 4] = *b"\0asm";

/// The largest module that is read, unpacked: ten times one of today.
pub const MAX_MODULE_BYTES: u64 = 30_000_000;

/// The module that steps swarms in a browser.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Module {
    /// As in its file: compressed by gzip.
    pub gzip: Vec<u8>,
    /// Unpacked.
    pub bytes: Vec<u8>,
    /// The licences of what it contains; empty if there is no file of them.
    pub licences: String,
}

/// Why a module cannot be used.
#[derive(Debug, Error)]
#[error("failed to read the wasm module {}: {source}", path.display())]
pub struct ModuleError {
    /// Its file.
    pub path: PathBuf,
    /// The system's error, or that it is no module.
    pub source: io::Error,
}

impl Module {
    /// Reads a file, such as `jostle.wasm.gz`.
    ///
    /// # Errors
    ///
    /// [`ModuleError`].
    pub fn read(path: &Path) -> Result<Self, ModuleError> {
        let fail = |source| ModuleError {
            path: path.to_owned(),
            source,
        };
        let wrong = |problem: &str| fail(io::Error::new(io::ErrorKind::InvalidData, problem));
        let (mut gzip, mut bytes) = (Vec::new(), Vec::new());
        let file = File::open(path).map_err(fail)?;
        file.take(MAX_MODULE_BYTES + 1)
            .read_to_end(&mut gzip)
            .map_err(fail)?;
        let unpacked = GzDecoder::new(&*gzip)
            .take(MAX_MODULE_BYTES + 1)
            .read_to_end(&mut bytes);
        if unpacked.is_err() || !bytes.starts_with(&MAGIC) {
            return Err(wrong(
                "it is no module compressed by gzip: packaging/wasm builds one",
            ));
        }
        if bytes.len() as u64 > MAX_MODULE_BYTES {
            return Err(wrong("it has more than 30 MB"));
        }
        let licences = std::fs::read_to_string(path.with_file_name(LICENCES));
        Ok(Self {
            gzip,
            bytes,
            licences: licences.unwrap_or_default(),
        })
    }

    /// Returns the file of the module that is installed with this program; none if there is none.
    #[must_use]
    pub fn installed() -> Option<PathBuf> {
        let program = std::env::current_exe().ok()?;
        let path = program.parent()?.parent()?.join(PLACE);
        path.is_file().then_some(path)
    }

    /// Returns the compressed module in base64.
    #[must_use]
    pub fn base64(&self) -> String {
        STANDARD.encode(&self.gzip)
    }
}
