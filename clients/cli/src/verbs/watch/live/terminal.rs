//! The terminal in raw mode with an alternate screen, restored however the process ends.

use std::io::{self, stdout};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::channel;
use std::thread;
use std::time::Duration;

use ratatui::DefaultTerminal;
use ratatui::crossterm::cursor::Show;
use ratatui::crossterm::event::{DisableBracketedPaste, EnableBracketedPaste};
use ratatui::crossterm::execute;

/// How long a terminal that accepts no output may delay the end of the process.
const RESTORE_TIMEOUT: Duration = Duration::from_millis(200);

static IS_TAKEN: AtomicBool = AtomicBool::new(false);

/// Takes the terminal. A panic restores it.
pub fn take() -> io::Result<DefaultTerminal> {
    IS_TAKEN.store(true, Ordering::SeqCst);
    let terminal = ratatui::try_init()?;
    // Otherwise a paste arrives as keys, which steer.
    execute!(stdout(), EnableBracketedPaste)?;
    Ok(terminal)
}

/// Restores the terminal if it was taken.
pub fn restore() {
    if !IS_TAKEN.swap(false, Ordering::SeqCst) {
        return;
    }
    let (done, is_done) = channel();
    thread::spawn(move || {
        // An error cannot be reported anywhere.
        let _ = execute!(stdout(), DisableBracketedPaste);
        let _ = ratatui::try_restore();
        let _ = execute!(stdout(), Show);
        let _ = done.send(());
    });
    let _ = is_done.recv_timeout(RESTORE_TIMEOUT);
}
