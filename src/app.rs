//! The daemon on the bus: query in, reply out; liveliness; shutdown.

use std::net::SocketAddr;
use std::num::NonZero;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::{Duration, Instant};

use jostle_proto::keys;
use thiserror::Error;
use tokio::time::MissedTickBehavior;
use tracing::{error, info, warn};
use zenoh::pubsub::Subscriber;
use zenoh::{Session, Wait};

use crate::api::admission::Admission;
use crate::api::context::Context;
use crate::api::executor::Executor;
use crate::api::idempotency::IdempotencyCache;
use crate::api::responder::Replies;
use crate::api::{commands, queries};
use crate::auth::folder::Folder;
use crate::auth::live::{Changes, LiveRights};
use crate::auth::{AuthError, Rights};
use crate::config::Config;
use crate::convert::commands::{CommandError, check_name};
use crate::convert::error::refusal;
use crate::experiments::ExperimentManager;
use crate::health::{Watch, Watched};
use crate::metrics::Pulse;
use crate::persistence::recovery;
use crate::persistence::recovery::RecoveryError;
use crate::playback::Uploads;
use crate::recording::Recordings;
use crate::store::{self, Store, StoreError, StoreFault};
use crate::swarm::registry::SwarmRegistry;
use crate::transport::http::{self, Bus, Gateway, GatewayError, Pass, Token};
use crate::transport::zenoh::bus_watch::BusWatch;
use crate::transport::zenoh::claims::{Claims, Contest, Watching};
use crate::transport::zenoh::dispatcher::Dispatcher;
use crate::transport::zenoh::gateway::{self, Connections, LifecycleNotifier};
use crate::transport::zenoh::messages::{DispatchMessage, MAX_QUEUED};
use crate::transport::zenoh::publisher::Press;
use crate::transport::zenoh::queryables::SwarmEndpoints;
use crate::transport::zenoh::session::{OpenRuntime, Opened, SessionError};
use crate::transport::zenoh::session_pool::SessionPool;
use crate::transport::zenoh::{progress, session, set_points};

/// The exit code when the store can no longer be trusted, or has not written all of it.
pub const EXIT_STORE: i32 = 8;

/// How long swarms may take to finish the step they are at when the daemon stops.
const PATIENCE_WITH_SWARMS: Duration = Duration::from_millis(500);

/// How long an experiment may take to finish the steps its runs are at, and its tables.
const PATIENCE_WITH_EXPERIMENTS: Duration = Duration::from_secs(1);

/// How long recordings may take to write what is left.
const PATIENCE_WITH_RECORDINGS: Duration = Duration::from_secs(1);

/// How long the store may take to write what is left.
const PATIENCE_WITH_STORE: Duration = Duration::from_secs(1);

/// How long closing the session may take; with a frozen client it would be ten seconds.
const PATIENCE_WITH_SESSION: Duration = Duration::from_secs(1);

/// How many days before its end a certificate is told of.
const DAYS_OF_NOTICE: i64 = 60;

/// How often the people are read again: a removed person's token is rejected within 5 s.
const PEOPLE_RELOAD_INTERVAL: Duration = Duration::from_secs(1);

/// Why the daemon does not serve.
#[derive(Debug, Error)]
pub enum ServerError {
    /// There is no session.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// zenoh refuses the daemon's own keys.
    #[error("cannot declare the daemon's keys: {0}")]
    Keys(String),
    /// The daemon's name cannot be part of a key.
    #[error("{}", .0.to_wire(None).message)]
    Name(CommandError),
    /// Who may do what cannot be told.
    #[error("auth_dir: {0}")]
    Rights(#[from] AuthError),
    /// HTTP cannot be served.
    #[error(transparent)]
    Gateway(#[from] GatewayError),
    /// What outlives the daemon cannot be opened.
    #[error("{0}")]
    Store(#[from] StoreError),
    /// What outlived it cannot be brought back.
    #[error("cannot bring the swarms back: {0}")]
    Recovery(#[from] RecoveryError),
    /// There is no place for recordings that are to be shown.
    #[error("cannot use {folder} for replays: {error}")]
    Uploads {
        /// Where they would be.
        folder: String,
        /// What the system says.
        error: std::io::Error,
    },
    /// The experiments cannot be read.
    #[error("cannot read the experiments in {folder}: {error}")]
    Lab {
        /// Where they are.
        folder: String,
        /// What the system says.
        error: std::io::Error,
    },
    /// The recordings cannot be read.
    #[error("cannot read the recordings in {folder}: {error}")]
    Recordings {
        /// Where they are.
        folder: String,
        /// What the system says.
        error: std::io::Error,
    },
    /// No thread can be started.
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
    /// The token of the page can neither be read nor written.
    #[error("cannot keep the page's token in the data directory: {0}")]
    Token(std::io::Error),
}

/// A daemon that serves.
pub struct Server {
    host: Arc<SwarmRegistry>,
    store: Store,
    connection: Connection,
    bus: Arc<BusWatch>,
    press: Arc<Press>,
    replies: Replies,
    messages: SyncSender<DispatchMessage>,
    endpoints: Vec<String>,
    watch: Arc<Watch>,
    gateway: Option<Gateway>,
    pass: Pass,
    lab: ExperimentManager,
    recordings: Recordings,
}

/// The zenoh session with its subscribers and the runtime below it, closed and dropped in this order:
/// zenoh panics when a subscriber is undeclared after the runtime was closed.
struct Connection {
    session: Session,
    pool: SessionPool,
    _subscribers: ([Subscriber<()>; 2], Watching),
    _runtime: OpenRuntime,
}

impl Connection {
    /// Closes the daemon's own session first: its liveliness token and claims are in it.
    fn close(&self) {
        if let Err(error) = self.session.close().wait() {
            warn!(%error, "failed to close the session");
        }
        self.pool.close();
    }
}

impl Drop for Connection {
    fn drop(&mut self) {
        self.close();
    }
}

/// Tells of certificates that end soon and passwords of nobody: at once, and once a day for as long
/// as the daemon runs.
async fn warn_of_people(rights: Arc<LiveRights>) {
    let mut days = tokio::time::interval(Duration::from_secs(24 * 60 * 60));
    loop {
        days.tick().await;
        match rights.current().expiry_warnings(DAYS_OF_NOTICE) {
            Ok(ending) => ending.iter().for_each(|line| warn!("{line}")),
            Err(error) => {
                warn!(%error, "failed to see which certificates end soon, and who is nobody");
            }
        }
    }
}

/// Reads the people again every second: what `jostled auth add` and `remove` change takes effect
/// without a restart.
async fn reload_people(rights: Arc<LiveRights>) {
    let mut ticks = tokio::time::interval(PEOPLE_RELOAD_INTERVAL);
    ticks.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut last_problem = None;
    loop {
        ticks.tick().await;
        let reloaded = tokio::task::spawn_blocking({
            let rights = rights.clone();
            move || rights.reload()
        });
        match reloaded.await {
            Ok(Ok(changes)) => {
                if changes != Changes::default() {
                    let Changes { added, removed } = changes;
                    info!(
                        added = added.join(" "),
                        removed = removed.join(" "),
                        "people changed"
                    );
                }
            }
            Ok(Err(error)) => {
                let problem = Some(error.to_string());
                if problem != last_problem {
                    warn!(%error, "failed to read the people again; rights stay as they were");
                }
            }
            Err(error) => error!(%error, "a defect: reading the people panicked"),
        }
        last_problem = rights.problem();
    }
}

/// A future behind a pointer.
type BoxedFuture<'a, T> = std::pin::Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// Opens the session and serves.
///
/// # Errors
///
/// [`ServerError`].
pub fn start(config: &Config) -> BoxedFuture<'_, Result<Server, ServerError>> {
    Box::pin(open(config))
}

/// [`start`], which is compiled here and not once more in each program that starts a server.
async fn open(config: &Config) -> Result<Server, ServerError> {
    let (prefix, node) = (&config.prefix, &config.node);
    check_name("node", node).map_err(ServerError::Name)?;
    check_name("prefix", prefix).map_err(ServerError::Name)?;
    let rights = match &config.auth_dir {
        Some(path) => Rights::read(Folder::at(path.clone()))?,
        None => Rights::Open,
    };
    let are_people_known = rights.users().is_some();
    let rights = Arc::new(LiveRights::new(rights));
    if are_people_known {
        tokio::spawn(warn_of_people(rights.clone()));
        tokio::spawn(reload_people(rights.clone()));
    }
    let http = match http::check(&config.http, config.auth_dir.is_some())? {
        Some(place) => {
            let acceptor = match &*rights.current() {
                Rights::Users { folder, .. } if place.is_secure => {
                    Some(http::acceptor(&folder.daemon()).map_err(GatewayError::Certificate)?)
                }
                _ => None,
            };
            Some((Gateway::bind(place.address).await?, acceptor))
        }
        None => None,
    };
    let store = open_store(config)?;
    let Opened {
        session,
        pool,
        runtime,
        clients,
    } = session::open(
        &config.listen,
        prefix,
        &rights.current(),
        config.max_clients,
    )
    .await?;
    let locators = session.info().locators().await;
    let mut endpoints: Vec<String> = locators.iter().map(ToString::to_string).collect();
    if endpoints.is_empty() {
        // For every address of a machine zenoh names those that others can reach, and here none is.
        endpoints.clone_from(&config.listen);
    }

    let replies = Replies::start()?;
    let (messages, received) = sync_channel(MAX_QUEUED);
    let (press, _) = Press::start(prefix, messages.clone())?;
    let refused = |error: zenoh::Error| ServerError::Keys(error.to_string());
    let waking = messages.clone();
    let (claims, watching_claims) = Claims::watch(&session, prefix, node, move || {
        // If the queue is full, the dispatcher thread is awake and reconciles anyway.
        let _ = waking.try_send(DispatchMessage::Claimed);
    })
    .map_err(refused)?;
    let notifier = Arc::new(LifecycleNotifier::new(messages.clone(), press.clone()));
    let host = Arc::new(SwarmRegistry::new(
        config.limits,
        notifier,
        Box::new(store.clone()),
    ));
    let idempotency = IdempotencyCache::new(store.clone(), are_people_known);
    let lab = open_lab(config).await?;
    let recordings = open_recordings(config, host.clone())?;
    let recording_files = Executor::start("recordings", recordings.clone())?;
    let folder = config.data_dir.join("replays");
    let uploads = Uploads::open(&folder).map_err(|error| ServerError::Uploads {
        folder: folder.display().to_string(),
        error,
    })?;
    progress::publish(lab.clone(), session.clone(), prefix.clone(), node.clone())?;
    let (pulse, watch) = (Arc::new(Pulse::default()), Arc::new(OnceLock::new()));
    let threads = vec![
        ("dispatch", pulse.clone()),
        ("publish", press.pulse.clone()),
        ("replies", replies.pulse.clone()),
    ];
    let url = match &http {
        Some((listener, acceptor)) => {
            let scheme = http::scheme(acceptor.is_some());
            Some(format!("{scheme}://{}", listener.local_addr()?))
        }
        None => None,
    };
    let context = Arc::new(Context {
        prefix: prefix.clone(),
        node: node.clone(),
        http: url,
        max_clients: config.max_clients,
        max_message_bytes: session::MAX_MESSAGE_BYTES - session::FRAMING_BYTES,
        peers: Arc::new(Connections {
            session: session.clone(),
            claims: claims.clone(),
        }),
        host: host.clone(),
        replies: replies.clone(),
        rights: rights.clone(),
        started: Instant::now(),
        store: store.clone(),
        idempotency: idempotency.clone(),
        schemas: queries::schemas(),
        lab: lab.clone(),
        experiment_files: Executor::start("experiments", lab.clone())?,
        uploads: Arc::new(uploads),
        recordings: recordings.clone(),
        recording_files: recording_files.clone(),
        watch: watch.clone(),
        is_recovering: AtomicBool::new(true),
        verifications: Arc::default(),
    });
    let gateway = Arc::new(gateway::Gateway {
        context: context.clone(),
        claims: claims.clone(),
        admission: Admission::default(),
        queued: AtomicUsize::new(0),
    });
    let dispatcher = Dispatcher {
        gateway: gateway.clone(),
        pool: pool.clone(),
        press: press.clone(),
        endpoints: SwarmEndpoints::new(
            session.clone(),
            pool.clone(),
            prefix.clone(),
            node.clone(),
            messages.clone(),
            gateway,
        ),
        held: Vec::new(),
        recovered: None,
        pulse,
    };
    thread::Builder::new()
        .name("dispatch".into())
        .spawn(move || dispatcher.run(&received))?;

    // No queryable has this key.
    let key = keys::node_get(prefix, node, "@probe");
    let bus = BusWatch::start(session.clone(), key, clients)?;
    let transports = session.clone();
    let mut probed = endpoints.clone();
    if let Some((listener, acceptor)) = &http {
        let protocol = http::scheme(acceptor.is_some());
        probed.push(format!("{protocol}/{}", listener.local_addr()?));
    }
    let watching = Watch::start(Watched {
        host: host.clone(),
        store: store.clone(),
        threads,
        endpoints: probed,
        sessions: Box::new(move || transports.info().transports().wait().count()),
        bus: {
            let bus = bus.clone();
            Box::new(move || bus.report())
        },
        contested: {
            let claims = claims.clone();
            Box::new(move || claims.contests().iter().map(Contest::for_health).collect())
        },
        certificate_ended: {
            let rights = rights.clone();
            Box::new(move || rights.current().ended())
        },
        are_people_unreadable: {
            let rights = rights.clone();
            Box::new(move || rights.problem().is_some())
        },
        recordings: {
            let recordings = recordings.clone();
            Box::new(move || commands::count(&recordings))
        },
        recordings_bytes: {
            let recordings = recordings.clone();
            Box::new(move || {
                let usage = recordings.usage();
                (usage.bytes, usage.quota_bytes)
            })
        },
    })?;
    let watching = watch.get_or_init(|| watching).clone();
    // Whoever looks after the daemon reaches it while its swarms are brought back.
    let pass = match are_people_known {
        false => Pass::Page(Token::of(&config.data_dir).map_err(ServerError::Token)?),
        true => Pass::People(rights.clone()),
    };
    let gateway = match http {
        Some((listener, acceptor)) => {
            let bus = Bus {
                session: session.clone(),
                pool: pool.clone(),
                prefix: prefix.clone(),
                node: node.clone(),
            };
            Some(Gateway::serve(
                listener,
                acceptor,
                bus,
                pass.clone(),
                watching.clone(),
            )?)
        }
        None => None,
    };

    // Every swarm is back before anyone is told that the daemon is there.
    let recovering = (host.clone(), store.clone());
    let recovered = tokio::task::spawn_blocking(move || {
        recovery::recover(&recovering.0, &recovering.1, &idempotency)
    });
    recovered.await.expect("recovery does not panic")?;
    commands::resume(&recordings, &recording_files, &host);

    context.is_recovering.store(false, Ordering::Release);
    let controls = set_points::listen(&session, prefix, host.clone(), rights.clone(), claims)
        .map_err(refused)?;
    let (recovered, opened) = sync_channel(1);
    let _ = messages.send(DispatchMessage::Recovered(recovered));
    let opened = tokio::task::spawn_blocking(move || opened.recv()).await;
    if let Ok(Ok(Err(error))) = opened {
        return Err(refused(error));
    }
    info!(node, endpoints = endpoints.join(" "), "serving");
    Ok(Server {
        host,
        store,
        connection: Connection {
            session,
            pool,
            _subscribers: (controls, watching_claims),
            _runtime: runtime,
        },
        bus,
        press,
        replies,
        messages,
        endpoints,
        watch: watching,
        gateway,
        pass,
        lab,
        recordings,
    })
}

/// Opens the experiments, which lie beside the store.
async fn open_lab(config: &Config) -> Result<ExperimentManager, ServerError> {
    let folder = config.data_dir.join("experiments");
    let cores = || thread::available_parallelism().unwrap_or(NonZero::<usize>::MIN);
    let threads = config.experiment_threads.unwrap_or_else(cores).get();
    let opened = tokio::task::spawn_blocking({
        let folder = folder.clone();
        move || ExperimentManager::open(&folder, threads)
    });
    opened
        .await
        .expect("opening does not panic")
        .map_err(|error| ServerError::Lab {
            folder: folder.display().to_string(),
            error,
        })
}

/// Opens the recordings, which lie there too.
fn open_recordings(config: &Config, host: Arc<SwarmRegistry>) -> Result<Recordings, ServerError> {
    let folder = config.data_dir.join("recordings");
    let quota_bytes = config.recordings_quota_bytes;
    let opened = Recordings::open(&folder, refusal, quota_bytes, host);
    opened.map_err(|error| ServerError::Recordings {
        folder: folder.display().to_string(),
        error,
    })
}

/// Opens what outlives the daemon. When it can no longer be trusted the daemon ends at once: only
/// another start tells what is safe.
fn open_store(config: &Config) -> Result<Store, StoreError> {
    let settings = store::Settings {
        quota_bytes: config.quota_bytes,
    };
    let on_fatal = Box::new(|fault: &StoreFault| {
        error!(%fault, "ending: start it again");
        eprintln!("jostled: {fault}");
        signal_hook::low_level::exit(EXIT_STORE)
    });
    Store::open(&config.data_dir, settings, on_fatal)
}

impl Server {
    /// Where clients reach it, such as `tcp/127.0.0.1:7447`.
    pub fn endpoints(&self) -> &[String] {
        &self.endpoints
    }

    /// Where it serves HTTP, if it does.
    pub fn http(&self) -> Option<SocketAddr> {
        self.gateway.as_ref().map(Gateway::address)
    }

    /// Where it serves HTTP, as a browser takes it.
    pub fn url(&self) -> Option<String> {
        self.gateway.as_ref().map(Gateway::url)
    }

    /// Where the page is, for whoever may steer, if there is one token for all: the link holds it,
    /// and belongs in no log.
    pub fn page(&self) -> Option<String> {
        let Pass::Page(token) = &self.pass else {
            return None;
        };
        Some(format!("http://{}/#token={}", self.http()?, token.text()))
    }

    /// What tells whether all is well.
    pub fn watch(&self) -> &Arc<Watch> {
        &self.watch
    }

    /// What zenoh calls its session.
    pub fn zid(&self) -> String {
        self.connection.session.zid().to_string()
    }

    /// What outlives it.
    pub fn store(&self) -> &Store {
        &self.store
    }

    /// The swarms it hosts.
    pub fn host(&self) -> &Arc<SwarmRegistry> {
        &self.host
    }

    /// How many clients are connected.
    pub fn sessions(&self) -> usize {
        self.connection.session.info().transports().wait().count()
    }

    /// Stops: no new orders, every swarm between two steps, goodbye. Takes less than two
    /// seconds whatever the clients do. Returns whether all that was to be written is on the disk.
    pub async fn stop(self) -> bool {
        info!("stopping");
        self.replies.close();
        self.watch.stop();
        self.bus.stop();
        if let Some(gateway) = &self.gateway {
            gateway.stop();
        }
        let _ = self.messages.try_send(DispatchMessage::Stop);
        let lab = self.lab.clone();
        let experiments = tokio::task::spawn_blocking(move || lab.stop(PATIENCE_WITH_EXPERIMENTS));
        let host = self.host.clone();
        let running = tokio::task::spawn_blocking(move || host.stop(PATIENCE_WITH_SWARMS));
        if let Ok(running @ 1..) = running.await {
            warn!(running, "swarms were still in a step");
        }
        if let Ok(running @ 1..) = experiments.await {
            warn!(running, "experiments were still in a step");
        }
        // What swarms showed last is in them.
        let recordings = self.recordings.clone();
        let recordings =
            tokio::task::spawn_blocking(move || recordings.close(PATIENCE_WITH_RECORDINGS));
        let store = self.store.clone();
        let stopped = tokio::task::spawn_blocking(move || store.stop(PATIENCE_WITH_STORE));
        let is_written = stopped.await.unwrap_or(false);
        if !is_written {
            error!(
                "not all is on the disk, which is full or slow: steps beyond the last `durable_step` \
                 are taken back, as after a crash"
            );
        }
        if let Ok(writing @ 1..) = recordings.await {
            warn!(
                writing,
                "recordings were still being written: what they had in hand is lost"
            );
        }
        self.press.stop();
        self.replies.stop();
        // Closing, and dropping what is declared, waits for every client, and blocks whoever does
        // it: a thread of its own, so that a frozen client delays neither timers nor the end.
        let (closed, is_closed) = std::sync::mpsc::channel();
        thread::spawn(move || {
            drop(self.connection);
            let _ = closed.send(());
        });
        let closing = move || is_closed.recv_timeout(PATIENCE_WITH_SESSION);
        match tokio::task::spawn_blocking(closing).await {
            Ok(Ok(())) => {}
            Ok(Err(_)) => warn!("a client does not take its goodbye"),
            failed => warn!(?failed, "failed to close the session"),
        }
        is_written
    }
}
