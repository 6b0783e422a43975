//! The database file: opening, tables, migrations.

use std::fs;
use std::os::unix::ffi::OsStrExt as _;
use std::path::Path;
use std::time::Duration;

use jostle_physics::model::MODEL_VERSION;
use rusqlite::config::DbConfig;
use rusqlite::{Connection, OpenFlags, Result as SqlResult, Transaction, TransactionBehavior};

use super::WAL;
use super::audit;
use super::error::StoreError;
use super::integrity::{self, Extent};
use crate::failpoint;

/// The file name of the database in a data folder.
pub const FILE: &str = "jostle.sqlite";

/// Marks the file as ours: "jost".
const APPLICATION_ID: i64 = 0x6A6F_7374;

/// How long a statement waits for a lock of another process, such as a shell that reads the file.
const BUSY_TIMEOUT: Duration = Duration::from_millis(20);

/// A migration from one schema to the next. All that are needed run in one transaction.
type Migration = fn(&Transaction<'_>) -> SqlResult<()>;

/// Migration k leads from schema k to k + 1.
const MIGRATIONS: &[Migration] = &[first, second, third, fourth];

/// The schema that this version writes, the newest that it reads.
pub const KNOWN: i64 = 4;

const _: () = assert!(MIGRATIONS.len() as i64 == KNOWN);

/// The kind of rows that are notes, which count against no quota but their own.
pub const NOTE: u8 = 6;

/// The index by which the notes of a swarm are found and counted. Its `kind` is [`NOTE`].
pub(super) const NOTES: &str =
    "CREATE INDEX note ON row (swarm, number, length(body)) WHERE kind = 6";

/// The columns of rows and of checkpoints.
pub(super) const ROW: &str = "(
     swarm INTEGER NOT NULL, number INTEGER NOT NULL, epoch INTEGER NOT NULL,
     step INTEGER NOT NULL, kind INTEGER NOT NULL, seal BLOB NOT NULL, body BLOB NOT NULL,
     PRIMARY KEY (swarm, number)
 ) WITHOUT ROWID";
pub(super) const CHECKPOINT: &str = "(
     swarm INTEGER NOT NULL, number INTEGER NOT NULL, epoch INTEGER NOT NULL,
     step INTEGER NOT NULL, seal BLOB NOT NULL, digest BLOB NOT NULL, body BLOB NOT NULL,
     PRIMARY KEY (swarm, number)
 ) WITHOUT ROWID";

/// The first schema.
///
/// Rows and checkpoints refer to their swarm by an id, so that the rows of a deleted swarm can be
/// swept in pieces while another swarm has its name; `gone` lists the ids that are not swept yet, and the
/// largest that is, as a negative number, so that no later swarm gets it.
/// For `extent` and `seal` see [`integrity`].
fn first(transaction: &Transaction<'_>) -> SqlResult<()> {
    transaction.execute_batch(&format!(
        "CREATE TABLE swarm (
             name TEXT PRIMARY KEY NOT NULL, id INTEGER NOT NULL, seal BLOB NOT NULL,
             about BLOB NOT NULL
         ) WITHOUT ROWID;
         CREATE TABLE extent (
             id INTEGER PRIMARY KEY, first INTEGER NOT NULL, last INTEGER NOT NULL,
             newest INTEGER NOT NULL, checkpoints INTEGER NOT NULL, bytes INTEGER NOT NULL,
             seal BLOB NOT NULL
         );
         CREATE TABLE row {ROW};
         CREATE TABLE checkpoint {CHECKPOINT};
         CREATE TABLE answer (
             id INTEGER PRIMARY KEY, client TEXT, request_id TEXT NOT NULL, digest BLOB NOT NULL,
             swarm TEXT NOT NULL, number INTEGER NOT NULL, is_ok INTEGER NOT NULL,
             encoding TEXT NOT NULL, seal BLOB NOT NULL, body BLOB NOT NULL
         );
         CREATE TABLE gone (swarm INTEGER PRIMARY KEY);",
    ))?;
    integrity::write_extent(transaction, integrity::REPLIES, &Extent::default())
}

/// The second schema: an index to delete replies by their request.
fn second(transaction: &Transaction<'_>) -> SqlResult<()> {
    transaction.execute_batch("CREATE INDEX answer_request ON answer (request_id)")
}

/// The third schema: the audit log, and an index of notes.
fn third(transaction: &Transaction<'_>) -> SqlResult<()> {
    transaction.execute_batch(audit::TABLES)?;
    transaction.execute_batch(NOTES)
}

/// The fourth schema: the program that has last opened the file, and the version of its model. An older
/// program whose model has a lower version leaves the file as it is.
fn fourth(transaction: &Transaction<'_>) -> SqlResult<()> {
    transaction.execute_batch(
        "CREATE TABLE program (
             id INTEGER PRIMARY KEY CHECK (id = 1), version TEXT NOT NULL, model INTEGER NOT NULL
         )",
    )
}

/// The version of this program.
const PROGRAM: &str = env!("CARGO_PKG_VERSION");

/// The program that has last opened the file, and the version of its model; none in earlier schemas.
fn program(connection: &Connection) -> Option<(String, i64)> {
    let columns = "SELECT version, model FROM program";
    let read = connection.query_row(columns, [], |row| Ok((row.get(0)?, row.get(1)?)));
    read.ok()
}

/// Notes that this program has opened the file.
fn note_program(connection: &Connection) -> SqlResult<()> {
    let own = (PROGRAM.to_owned(), i64::from(MODEL_VERSION));
    if program(connection).is_none_or(|it| it != own) {
        let insert = "INSERT OR REPLACE INTO program (id, version, model) VALUES (1, ?, ?)";
        connection.execute(insert, (own.0, own.1))?;
    }
    Ok(())
}

/// Opens the writer's connection to `file`, creates or migrates the tables, and checks the pages of a
/// file of at most `max_checked_bytes`.
pub(super) fn open(file: &Path, max_checked_bytes: u64) -> Result<Connection, StoreError> {
    let fail = |error| StoreError::of_reading(file, &error);
    let mut connection = Connection::open(file).map_err(fail)?;
    connection.busy_timeout(BUSY_TIMEOUT).map_err(fail)?;
    // A file that is rejected keeps its WAL; a connection without one leaves none.
    let keeps = DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE;
    let has_wal = fs::metadata(file.with_file_name(WAL)).is_ok_and(|it| it.len() > 0);
    connection.set_db_config(keeps, has_wal).map_err(fail)?;
    let is_new = check_origin(file, &connection)?;
    connection.set_db_config(keeps, false).map_err(fail)?;
    if is_new {
        // Effective only before the first table.
        connection
            .pragma_update(None, "auto_vacuum", "INCREMENTAL")
            .map_err(fail)?;
    }
    configure(&connection).map_err(fail)?;
    let mode: String = connection
        .pragma_update_and_check(None, "journal_mode", "WAL", |row| row.get(0))
        .map_err(fail)?;
    if !mode.eq_ignore_ascii_case("wal") {
        let problem = "its file system does not support shared memory";
        return Err(StoreError::Io {
            file: file.to_path_buf(),
            detail: format!("{problem}: the journal mode is {mode:?}"),
        });
    }
    if fs::metadata(file).is_ok_and(|file| file.len() <= max_checked_bytes) {
        check_pages(file, &connection)?;
    }
    migrate(&mut connection).map_err(fail)?;
    note_program(&connection).map_err(fail)?;
    Ok(connection)
}

/// Opens a read-only connection, which does not checkpoint the WAL when it closes.
pub(super) fn open_reader(file: &Path) -> Result<Connection, StoreError> {
    let open = || {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(file, flags)?;
        connection.busy_timeout(BUSY_TIMEOUT)?;
        configure(&connection)?;
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
        connection.pragma_update(None, "query_only", true)?;
        Ok(connection)
    };
    open().map_err(|error| StoreError::of_reading(file, &error))
}

/// Opens a connection that changes no file and creates none.
///
/// SQLite creates the WAL and its index, `-shm`, of a file that it only reads, and removes them when the last
/// connection closes. So it may not open them here but where both exist: it then reads an index that a daemon
/// keeps, or, if none does, builds one in memory. Without an index no daemon has the file open, and no lock is
/// needed: exclusive access to the WAL, with a VFS that locks nothing, has an index in memory, too. Without
/// a WAL the file is complete.
pub(super) fn open_unchanged(file: &Path) -> Result<Connection, StoreError> {
    let fail = |error| StoreError::of_reading(file, &error);
    let beside = |suffix: &str| {
        let mut path = file.as_os_str().to_owned();
        path.push(suffix);
        fs::metadata(path).ok().map(|file| file.len())
    };
    let (parameters, is_exclusive) = match (beside("-wal"), beside("-shm")) {
        (Some(_), Some(_)) => ("mode=ro&readonly_shm=1", false),
        (Some(1..), None) => ("mode=ro&vfs=unix-none", true),
        _ => ("mode=ro&immutable=1", false),
    };
    let open = || {
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
            | OpenFlags::SQLITE_OPEN_URI
            | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(uri(file, parameters), flags)?;
        connection.busy_timeout(BUSY_TIMEOUT)?;
        connection.set_db_config(DbConfig::SQLITE_DBCONFIG_NO_CKPT_ON_CLOSE, true)?;
        if is_exclusive {
            connection.pragma_update(None, "locking_mode", "EXCLUSIVE")?;
        }
        configure(&connection)?;
        connection.pragma_update(None, "query_only", true)?;
        Ok(connection)
    };
    open().map_err(fail)
}

/// The URI of a file for SQLite.
fn uri(file: &Path, parameters: &str) -> String {
    let absolute = std::path::absolute(file).unwrap_or_else(|_| file.to_owned());
    let mut uri = "file:".to_owned();
    for byte in absolute.as_os_str().as_bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'-' | b'_' => {
                uri.push(char::from(*byte));
            }
            byte => uri.push_str(&format!("%{byte:02X}")),
        }
    }
    format!("{uri}?{parameters}")
}

fn configure(connection: &Connection) -> SqlResult<()> {
    connection.pragma_update(None, "synchronous", "FULL")?;
    connection.pragma_update(None, "foreign_keys", false)?;
    connection.pragma_update(None, "temp_store", "MEMORY")?;
    // More than the statements that the writer has, so that none is compiled twice.
    connection.set_prepared_statement_cache_capacity(64);
    // The writer checkpoints the WAL itself: SQLite would ignore a failed sync.
    connection.pragma_update(None, "wal_autocheckpoint", 0)?;
    connection.pragma_update(None, "cell_size_check", true)
}

/// Whether the file is new.
///
/// # Errors
///
/// [`StoreError::Foreign`], [`StoreError::Newer`], [`StoreError::Corrupt`].
pub(super) fn check_origin(file: &Path, connection: &Connection) -> Result<bool, StoreError> {
    let fail = |error| StoreError::of_reading(file, &error);
    let number = |pragma| connection.pragma_query_value(None, pragma, |row| row.get::<_, i64>(0));
    let application = number("application_id").map_err(fail)?;
    let version = number("user_version").map_err(fail)?;
    let tables: i64 = connection
        .query_row("SELECT count(*) FROM sqlite_schema", [], |row| row.get(0))
        .map_err(fail)?;
    if (application, version, tables) == (0, 0, 0) {
        return Ok(true);
    }
    if application != APPLICATION_ID {
        return Err(StoreError::Foreign(file.to_path_buf()));
    }
    let (writer, model) = program(connection).unzip();
    let model_known = i64::from(MODEL_VERSION);
    let newer = [
        ("schema", version, KNOWN),
        ("model version", model.unwrap_or(model_known), model_known),
    ];
    if let Some((what, found, known)) = newer.into_iter().find(|(_, found, known)| found > known) {
        return Err(StoreError::Newer {
            file: file.to_path_buf(),
            writer,
            what,
            found,
            known,
        });
    }
    if version < 1 || tables == 0 {
        return Err(StoreError::Corrupt {
            file: file.to_path_buf(),
            detail: format!("schema {version} with {tables} tables is impossible"),
        });
    }
    Ok(false)
}

/// Has SQLite check the structure of all pages.
///
/// # Errors
///
/// [`StoreError::Corrupt`] and those of any read.
pub(super) fn check_pages(file: &Path, connection: &Connection) -> Result<(), StoreError> {
    let found: String = connection
        .query_row("PRAGMA quick_check(1)", [], |row| row.get(0))
        .map_err(|error| StoreError::of_reading(file, &error))?;
    match found.as_str() {
        "ok" => Ok(()),
        _ => Err(StoreError::Corrupt {
            file: file.to_path_buf(),
            detail: found,
        }),
    }
}

fn migrate(connection: &mut Connection) -> SqlResult<()> {
    let version: i64 = connection.pragma_query_value(None, "user_version", |row| row.get(0))?;
    if version == KNOWN {
        return Ok(());
    }
    let transaction = connection.transaction_with_behavior(TransactionBehavior::Immediate)?;
    let done = usize::try_from(version).unwrap_or(0);
    for migration in &MIGRATIONS[done..] {
        migration(&transaction)?;
    }
    transaction.pragma_update(None, "application_id", APPLICATION_ID)?;
    transaction.pragma_update(None, "user_version", KNOWN)?;
    failpoint::kill("store-migrating");
    transaction.commit()?;
    failpoint::kill("store-migrated");
    Ok(())
}
