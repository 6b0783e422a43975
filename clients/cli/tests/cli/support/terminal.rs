//! A command line in a terminal of its own, which `script` provides.

use std::io::{Read, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;

use crate::support::until;

/// The size of the terminal.
const ROWS: usize = 24;
const COLUMNS: usize = 80;

/// A shell in a terminal of 24 lines of 80, running one command line.
pub struct Terminal {
    child: Child,
    keys: ChildStdin,
    seen: Arc<Mutex<Vec<u8>>>,
}

impl Terminal {
    /// Starts a command line. The shell around it prints the process id, the exit code and the
    /// terminal's settings before and after.
    pub fn begin(endpoint: &str, line: &str) -> Self {
        Self::of(
            endpoint,
            &format!(
                "stty rows {ROWS} cols {COLUMNS}; echo before $(stty -g); \
                 sh -c 'echo process $$.; exec \"$JOSTLE\" {line}'; \
                 echo code $?.; echo after $(stty -g); echo over."
            ),
        )
    }

    /// Starts an interactive bash with completion.
    pub fn bash(endpoint: &str) -> Self {
        let programs = Path::new(env!("CARGO_BIN_EXE_jostle")).parent().unwrap();
        let mut terminal = Self::of(endpoint, "bash --norc --noprofile -i");
        terminal.press(&format!("PATH={}:$PATH\r", programs.display()));
        terminal.press("PS1=; source <(JOSTLE_COMPLETE=bash jostle); echo rea''dy\r");
        terminal
    }

    fn of(endpoint: &str, shell: &str) -> Self {
        let mut child = Command::new("script")
            .args(["-qfec", shell, "/dev/null"])
            .env("JOSTLE", env!("CARGO_BIN_EXE_jostle"))
            .env("JOSTLE_ENDPOINT", endpoint)
            .env("TERM", "xterm-256color")
            .env("SHELL", "/bin/sh")
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let keys = child.stdin.take().unwrap();
        let mut output = child.stdout.take().unwrap();
        let seen = Arc::new(Mutex::new(Vec::new()));
        let written = seen.clone();
        thread::spawn(move || {
            let mut piece = [0; 4096];
            while let Ok(length @ 1..) = output.read(&mut piece) {
                written.lock().unwrap().extend(&piece[..length]);
            }
        });
        Terminal { child, keys, seen }
    }

    /// Presses keys.
    pub fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).unwrap();
        self.keys.flush().unwrap();
    }

    /// All that was written so far.
    pub fn seen(&self) -> String {
        // A piece may end within a character.
        String::from_utf8_lossy(&self.seen.lock().unwrap()).into_owned()
    }

    /// Waits until a text is on the screen, or was written in one piece.
    pub async fn until_seen(&self, what: &str) {
        until(what, async || {
            let seen = self.seen();
            seen.contains(what) || screen(&seen).contains(what)
        })
        .await;
    }

    /// Waits until a text is no longer on the screen.
    pub async fn until_gone(&self, what: &str) {
        until(what, async || !screen(&self.seen()).contains(what)).await;
    }

    /// Sends the process of the command line a signal.
    pub fn signal(&self, signal: &str) {
        let pid = self.shown("process ");
        let status = Command::new("kill").args([signal, &pid]).status().unwrap();
        assert!(status.success());
    }

    /// Waits until it ends and returns its exit code. The terminal is as it was before.
    pub async fn end(mut self) -> String {
        self.until_seen("over.").await;
        self.child.wait().unwrap();
        let seen = self.seen();
        assert_eq!(self.shown("before "), self.shown("after "), "{seen}");
        let of = |sequence: &str| seen.rfind(sequence);
        assert!(of("\x1b[?1049l") > of("\x1b[?1049h"), "the screen is back");
        assert!(of("\x1b[?25h") > of("\x1b[?25l"), "the cursor is back");
        self.shown("code ")
    }

    /// Waits until a command line without a full screen ends, and returns its exit code.
    pub async fn code(mut self) -> String {
        self.until_seen("over.").await;
        self.child.wait().unwrap();
        self.shown("code ")
    }

    /// A value that the shell printed.
    fn shown(&self, name: &str) -> String {
        let seen = self.seen();
        let start = seen.find(name).unwrap() + name.len();
        let rest = &seen[start..];
        let end = rest.find(['\r', '\n', '.']).unwrap();
        rest[..end].to_owned()
    }
}

/// The contents of the screen after the written text, which has only changes.
fn screen(written: &str) -> String {
    let mut cells = vec![vec![' '; COLUMNS]; ROWS];
    let (mut row, mut column) = (0, 0);
    let mut characters = written.chars();
    while let Some(character) = characters.next() {
        match character {
            '\x1b' => {
                let mut numbers = String::new();
                let end = characters.by_ref().skip(1).find(|it| {
                    numbers.push(*it);
                    it.is_ascii_alphabetic()
                });
                numbers.pop();
                match end {
                    Some('H') => {
                        let mut at = numbers.split(';').map(|it| it.parse().unwrap_or(1));
                        row = at.next().unwrap_or(1) - 1;
                        column = at.next().unwrap_or(1) - 1;
                    }
                    Some('J') => cells = vec![vec![' '; COLUMNS]; ROWS],
                    _ => {}
                }
            }
            '\r' => column = 0,
            '\n' => row += 1,
            character => {
                if let Some(cell) = cells.get_mut(row).and_then(|row| row.get_mut(column)) {
                    *cell = character;
                }
                column += 1;
            }
        }
    }
    let lines = cells.iter().map(|line| line.iter().collect::<String>());
    lines.collect::<Vec<_>>().join("\n")
}

impl Drop for Terminal {
    fn drop(&mut self) {
        // After a failed test; `script` closes its terminal.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
