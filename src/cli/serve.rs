//! `jostled serve` and `jostled demo`.

use std::io::IsTerminal as _;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Duration;

use jostle_experiment::stdout;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tracing::warn;
use tracing_subscriber::EnvFilter;

use crate::app::{self, ServerError};
use crate::cli::{demo, fail, note, process, start_error, systemd};
use crate::config::{Config, Resolved};
use crate::swarm::recovery_progress::RecoveryProgress;
use crate::transport::http::{GatewayError, Token};
use crate::transport::zenoh::session::SessionError;

/// The mode of the daemon.
#[derive(Clone, Copy, Debug)]
pub enum Mode {
    /// Serves until a signal.
    Serve,
    /// Runs the demo, which ends after this time if one is given.
    Demo(Option<Duration>),
}

/// Serves until a signal or the end of the demo, and exits the process.
pub fn run(
    config: &Config,
    resolved: &Resolved,
    filter: EnvFilter,
    mode: Mode,
    temporary: Option<tempfile::TempDir>,
) -> ExitCode {
    let logs = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr)
        // It would report them on standard error, too, and panic in the thread that logs.
        .log_internal_errors(false);
    if config.logs_json {
        logs.json().init();
    } else {
        logs.init();
    }
    process::raise_file_limit(config.max_clients);
    if let Some(points) = std::env::var_os("FAILPOINTS") {
        warn!(?points, "failpoints enabled");
    }
    // zenoh needs a runtime with more than one thread.
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build();
    let code = match runtime {
        Ok(runtime) => runtime.block_on(serve(config, resolved, mode)),
        Err(error) => return fail(1, &error),
    };
    // Skips the exit handlers: zenoh's waited ten seconds for a frozen client. Does not wait for
    // threads in a long step.
    if let Some(temporary) = temporary {
        let _ = temporary.close();
    }
    signal_hook::low_level::exit(code)
}

/// Returns the exit code.
async fn serve(config: &Config, resolved: &Resolved, mode: Mode) -> i32 {
    let recovery = Arc::<RecoveryProgress>::default();
    let starting = tokio::spawn(systemd::notify_recovery(recovery.clone()));
    let started = app::start_with(config, recovery).await;
    starting.abort();
    let server = match started {
        Ok(server) => server,
        Err(error) => {
            let code = if is_of_machine(&error) { 1 } else { 2 };
            let is_demo = matches!(mode, Mode::Demo(_));
            let user = rustix::process::geteuid().as_raw();
            fail(
                code,
                &start_error::message(&error, config, resolved, is_demo, user),
            );
            return code.into();
        }
    };
    // Before the first line is printed: its reader may stop the daemon at once. During the start the
    // signals end the process, as a kill would.
    let mut stop = StopSignals::install();
    for endpoint in &server.endpoints {
        announce(&format!("listening on {endpoint}"));
    }
    if let Some(url) = server.url() {
        announce(&format!("http on {url}"));
    }
    if let Some(link) = server.page() {
        // Without a terminal the output may be a log, which must not contain the token.
        let page = match std::io::stdout().is_terminal() {
            true => link,
            false => {
                let url = link.split('#').next().unwrap_or_default();
                let file = Token::file_in(&config.data_dir);
                format!("{url} with the token in {}", file.display())
            }
        };
        announce(&format!("page on {page}"));
    }
    let notifier = systemd::notify_status(server.watch.clone(), server.registry.clone());
    let notifier = tokio::spawn(notifier);
    let code = match mode {
        Mode::Serve => {
            stop.received().await;
            0
        }
        Mode::Demo(duration) => tokio::select! {
            ended = demo::run(config, &server.endpoints[0], duration) => match ended {
                Ok(()) => 0,
                Err(demo::DemoError::Deleted) if duration.is_none() => {
                    note(&"jostled: the demo's swarm was deleted; still serving, Ctrl-C stops");
                    stop.received().await;
                    0
                }
                Err(error) => {
                    fail(1, &error);
                    1
                }
            },
            () = stop.received() => 0,
        },
    };
    notifier.abort();
    systemd::notify_stopping();
    match server.stop().await {
        false if code == 0 => app::EXIT_STORE,
        _ => code,
    }
}

/// Prints a line on standard output. The daemon serves without it: its log may be on a full disk.
fn announce(line: &str) {
    let written = stdout::write(format!("{line}\n").as_bytes());
    if let Err(error) = stdout::unless_closed(written) {
        warn!(%error, line, "a line is missing");
    }
}

/// Whether the cause is the machine, not a setting.
fn is_of_machine(error: &ServerError) -> bool {
    matches!(
        error,
        ServerError::Keys(_)
            | ServerError::Recovery(_)
            | ServerError::Folder { .. }
            | ServerError::Thread(_)
            | ServerError::Token(_)
            | ServerError::Gateway(GatewayError::Listen { .. })
            | ServerError::Session(SessionError::Listen { .. } | SessionError::Setting(_))
    )
}

/// SIGTERM and SIGINT, if their handlers could be installed. Without handlers they end the process.
struct StopSignals(Option<(Signal, Signal)>);

impl StopSignals {
    fn install() -> Self {
        let terminate = signal(SignalKind::terminate());
        StopSignals(
            terminate
                .and_then(|it| Ok((it, signal(SignalKind::interrupt())?)))
                .ok(),
        )
    }

    /// Completes when one is received.
    async fn received(&mut self) {
        let Some((terminate, interrupt)) = &mut self.0 else {
            return std::future::pending().await;
        };
        tokio::select! {
            _ = terminate.recv() => {}
            _ = interrupt.recv() => {}
        }
    }
}
