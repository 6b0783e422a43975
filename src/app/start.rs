//! The start of the daemon: [`open`] lists the steps, each of which is a function below it.

use std::io::Write as _;
use std::path::Path;
use std::sync::atomic::AtomicUsize;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, OnceLock};
use std::thread;
use std::time::Instant;

use jostle_experiment::html::{Module, ModuleError};
use jostle_proto::keys;
use tokio::net::TcpListener;
use tokio::task::spawn_blocking;
use tokio_rustls::TlsAcceptor;
use tracing::{error, info, warn};
use zenoh::{Session, Wait};

use crate::api::admission::Admission;
use crate::api::context::Context;
use crate::api::idempotency::IdempotencyCache;
use crate::api::responder::Replies;
use crate::api::{commands, queries};
use crate::app::data_folder;
use crate::app::error::{EXIT_STORE, ServerError};
use crate::app::server::{Connection, Server};
use crate::app::users;
use crate::audit::AuditLog;
use crate::auth::Rights;
use crate::auth::live::LiveRights;
use crate::config::Config;
use crate::convert::commands::check_name;
use crate::experiments::ExperimentManager;
use crate::failpoint;
use crate::health::{HealthMonitor, HealthSources};
use crate::lanes::Lanes;
use crate::metrics::Activity;
use crate::persistence::limits::UserLimits;
use crate::persistence::recovery::{self, OnRecovered};
use crate::playback::Uploads;
use crate::recording::{Position, Recordings};
use crate::store::{self, Store, StoreError, StoreFault};
use crate::swarm::recovery_progress::RecoveryProgress;
use crate::swarm::registry::SwarmRegistry;
use crate::transport::http::{self, Bus, Credentials, Gateway, GatewayError, Token};
use crate::transport::open_requests::OpenRequests;
use crate::transport::zenoh::bus_watch::BusWatch;
use crate::transport::zenoh::claims::{ClaimSubscribers, Claims, Contest};
use crate::transport::zenoh::dispatcher::Dispatcher;
use crate::transport::zenoh::gateway::{self, Connections};
use crate::transport::zenoh::messages::{DispatchMessage, MAX_QUEUED};
use crate::transport::zenoh::publisher::Publisher;
use crate::transport::zenoh::queryables::SwarmEndpoints;
use crate::transport::zenoh::session_pool::SessionPool;
use crate::transport::zenoh::tokens::Tokens;
use crate::transport::zenoh::wait_tokens::WaitTokens;
use crate::transport::zenoh::{progress, session, set_points};

type BoxedFuture<'a, T> = std::pin::Pin<Box<dyn Future<Output = T> + Send + 'a>>;

/// Starts the daemon. When this returns, every swarm of the previous run is recovered, and the
/// daemon's keys are declared.
pub fn start(config: &Config) -> BoxedFuture<'_, Result<Server, ServerError>> {
    start_with(config, Arc::default())
}

/// As [`start`]; `recovery` shows meanwhile how many swarms are left.
pub fn start_with(
    config: &Config,
    recovery: Arc<RecoveryProgress>,
) -> BoxedFuture<'_, Result<Server, ServerError>> {
    // Boxed, so that it is compiled here and not again in each program that starts a daemon.
    Box::pin(open(config, recovery))
}

async fn open(config: &Config, recovery: Arc<RecoveryProgress>) -> Result<Server, ServerError> {
    check_name("node", &config.node).map_err(ServerError::Name)?;
    check_name("prefix", &config.prefix).map_err(ServerError::Name)?;
    let audit = Arc::new(OnceLock::new());
    let rights = users::open(config, &audit)?;
    check_certificate(config, &rights)?;
    let http = HttpListener::bind(config, &rights).await?;
    data_folder::check(&config.data_dir)?;
    let other_data = data_folder::other_data(&config.data_dir, &config.node);
    let store = open_store(config)?;
    if let Some(message) = &other_data {
        warn!("{message}");
    }
    let opened = session::open(
        &config.listen,
        &config.prefix,
        &rights.current(),
        config.max_clients,
    )
    .await?;
    let endpoints = endpoints(config, &opened.session).await;

    let (session, pool) = (opened.session, opened.pool);
    let (core, received, claim_subscribers) = Core::start(config, rights, store, session, pool)?;
    let _ = audit.set(core.audit.clone());
    let files = Files::open(config, &core).await?;
    progress::publish(
        files.experiments.clone(),
        core.session.clone(),
        config.prefix.clone(),
        config.node.clone(),
    )?;
    let watch = Arc::new(OnceLock::new());
    let url = http.as_ref().map(HttpListener::url).transpose()?;
    let context = context(
        config,
        &core,
        &files,
        url,
        (watch.clone(), recovery.clone()),
    );
    let activity = start_dispatcher(config, &core, context, received)?;
    // Before anything can be requested: no reply may say that a stored swarm does not exist.
    let stored = open_recovering(&core, &recovery).await?;

    // The probe's key must have no queryable.
    let probe = keys::node_get(&config.prefix, &config.node, "@probe");
    let bus = BusWatch::start(core.session.clone(), probe, opened.clients)?;
    let mut probed = endpoints.clone();
    if let Some(http) = &http {
        probed.push(http.endpoint()?);
    }
    let recovering = (recovery.clone(), other_data);
    let started = start_watch(&core, &files, bus.clone(), activity, probed, recovering)?;
    let watch = watch.get_or_init(|| started).clone();
    // Before the recovery, which may take long: the health checks must be reachable meanwhile.
    let credentials = credentials(config, &core)?;
    let gateway = match http {
        Some(http) => {
            let shared = (watch.clone(), recovery.clone());
            Some(http.serve(config, &core, credentials.clone(), shared)?)
        }
        None => None,
    };

    // Before the recovery: a swarm replies as soon as it is recovered, and a controller may join it, or a client
    // wait for a condition, then.
    let waits = core.waits.listen(&core.session);
    let waits = waits.map_err(|error| keys_error(&error))?;
    let set_point_subscribers = set_points::listen(
        &core.session,
        &config.prefix,
        core.registry.clone(),
        core.rights.clone(),
        core.claims.clone(),
        core.tokens.clone(),
    )
    .map_err(|error| keys_error(&error))?;
    recover(&core, &files.recordings, stored, recovery).await?;
    files.experiments.resume_all();
    failpoint::kill("daemon-recovered");
    // After the recovery: a client that sees the daemon finds its swarms.
    announce_node(&core.messages).await?;
    info!(
        node = config.node,
        endpoints = endpoints.join(" "),
        "serving"
    );
    Ok(Server {
        registry: core.registry,
        store: core.store,
        connection: Connection {
            session: core.session,
            pool: core.pool,
            _subscribers: (set_point_subscribers, claim_subscribers, waits),
            _runtime: opened.runtime,
        },
        bus,
        publisher: core.publisher,
        replies: core.replies,
        messages: core.messages,
        endpoints,
        watch,
        gateway,
        credentials,
        audit: core.audit,
        experiments: files.experiments,
        recordings: files.recordings,
    })
}

/// If the daemon serves over TLS, checks its certificate.
fn check_certificate(config: &Config, rights: &LiveRights) -> Result<(), GatewayError> {
    let has_tls = config.http.starts_with("https://")
        || config.listen.iter().any(|it| it.starts_with("tls/"));
    if let Rights::Users { folder, .. } = &*rights.current()
        && has_tls
        && let Some(warning) = http::check_certificate(folder)?
    {
        warn!("{warning}");
    }
    Ok(())
}

/// The listener of the HTTP server.
struct HttpListener {
    listener: TcpListener,
    acceptor: Option<TlsAcceptor>,
    module: Option<Module>,
}

impl HttpListener {
    /// Binds the address; `None` if the daemon serves no HTTP.
    async fn bind(config: &Config, rights: &LiveRights) -> Result<Option<Self>, ServerError> {
        let Some(place) = http::check(&config.http, config.auth_dir.is_some())? else {
            return Ok(None);
        };
        let acceptor = match &*rights.current() {
            Rights::Users { folder, .. } if place.is_secure => {
                Some(http::acceptor(folder).map_err(GatewayError::Certificate)?)
            }
            _ => None,
        };
        let module = module(config.wasm.as_deref()).map_err(GatewayError::Module)?;
        let listener = Gateway::bind(place.address).await?;
        Ok(Some(HttpListener {
            listener,
            acceptor,
            module,
        }))
    }

    fn url(&self) -> std::io::Result<String> {
        let scheme = http::scheme(self.acceptor.is_some());
        Ok(format!("{scheme}://{}", self.listener.local_addr()?))
    }

    /// The address in the form of a zenoh endpoint, for the health checks.
    fn endpoint(&self) -> std::io::Result<String> {
        let scheme = http::scheme(self.acceptor.is_some());
        Ok(format!("{scheme}/{}", self.listener.local_addr()?))
    }

    fn serve(
        self,
        config: &Config,
        core: &Core,
        credentials: Credentials,
        (watch, recovery): (Arc<HealthMonitor>, Arc<RecoveryProgress>),
    ) -> std::io::Result<Gateway> {
        let bus = Bus {
            session: core.session.clone(),
            pool: core.pool.clone(),
            prefix: config.prefix.clone(),
            node: config.node.clone(),
            recovery,
            open: core.open.clone(),
        };
        Gateway::serve(
            self.listener,
            (self.acceptor, self.module),
            bus,
            credentials,
            watch,
            core.lanes.clone(),
        )
    }
}

/// The module with which the page verifies swarms: the one that is given, or the installed one.
fn module(given: Option<&Path>) -> Result<Option<Module>, ModuleError> {
    if let Some(path) = given {
        return Module::read(path).map(Some);
    }
    let installed = Module::installed().map(|path| Module::read(&path));
    match installed.transpose() {
        Ok(module) => Ok(module),
        // Only the page lacks it.
        Err(error) => {
            warn!("{error}");
            Ok(None)
        }
    }
}

/// Opens the store. If it fails later, the process exits at once: only a recovery finds out what is
/// durable.
fn open_store(config: &Config) -> Result<Store, StoreError> {
    let settings = store::Settings {
        quota_bytes: config.quota_bytes,
        audit_bytes: config.audit_bytes,
        audit_ms: config.audit_ms,
    };
    let on_fatal = Box::new(|fault: &StoreFault| {
        error!(%fault, "the store failed: exiting; restart the daemon");
        // `eprintln` panics if standard error is on a full disk, and the process would not exit.
        let _ = writeln!(std::io::stderr(), "jostled: {fault}");
        signal_hook::low_level::exit(EXIT_STORE)
    });
    Store::open(&config.data_dir, settings, on_fatal)
}

/// The endpoints by which clients reach the session.
async fn endpoints(config: &Config, session: &Session) -> Vec<String> {
    let locators = session.info().locators().await;
    if locators.is_empty() {
        // For an unspecified address zenoh lists the machine's external addresses; this one has none.
        return config.listen.clone();
    }
    locators.iter().map(ToString::to_string).collect()
}

/// The swarms, and the parts by which requests reach them and replies and states leave.
struct Core {
    rights: Arc<LiveRights>,
    store: Store,
    session: Session,
    pool: SessionPool,
    replies: Replies,
    lanes: Lanes,
    open: OpenRequests,
    publisher: Arc<Publisher>,
    messages: SyncSender<DispatchMessage>,
    claims: Arc<Claims>,
    tokens: Tokens,
    waits: WaitTokens,
    registry: Arc<SwarmRegistry>,
    idempotency: IdempotencyCache,
    audit: AuditLog,
}

impl Core {
    /// Starts the threads of replies and of the publisher, and reads the claims of other daemons.
    /// Returns the receiver for the dispatcher and the subscribers of the claims, too.
    fn start(
        config: &Config,
        rights: Arc<LiveRights>,
        store: Store,
        session: Session,
        pool: SessionPool,
    ) -> Result<(Self, Receiver<DispatchMessage>, ClaimSubscribers), ServerError> {
        let replies = Replies::start()?;
        let lanes = Lanes::start()?;
        let (messages, received) = sync_channel(MAX_QUEUED);
        let publisher = Publisher::start(&config.prefix, messages.clone())?;
        let wake = messages.clone();
        let (claims, subscribers) =
            Claims::watch(&session, &config.prefix, &config.node, move || {
                // If the queue is full, the dispatcher is awake and reconciles anyway.
                let _ = wake.try_send(DispatchMessage::Claimed);
            })
            .map_err(|error| keys_error(&error))?;
        let observer = Arc::new(messages.clone());
        let registry = SwarmRegistry::new(config.limits, observer, Box::new(store.clone()));
        let has_users = rights.current().users().is_some();
        let core = Core {
            audit: AuditLog::open(store.clone())?,
            idempotency: IdempotencyCache::new(store.clone(), has_users),
            rights,
            store,
            session,
            pool,
            replies,
            lanes,
            open: OpenRequests::default(),
            publisher,
            messages,
            claims,
            tokens: Tokens::new(&config.prefix),
            waits: WaitTokens::new(&config.prefix),
            registry: Arc::new(registry),
        };
        Ok((core, received, subscribers))
    }
}

/// The experiments and recordings, which have folders beside the store.
struct Files {
    experiments: ExperimentManager,
    recordings: Recordings,
    uploads: Arc<Uploads>,
}

impl Files {
    async fn open(config: &Config, core: &Core) -> Result<Self, ServerError> {
        let [experiments, recordings, replays] =
            ["experiments", "recordings", "replays"].map(|name| config.data_dir.join(name));
        let threads = config.experiment_threads();
        let quota_bytes = config.experiments_quota_bytes;
        let registry = core.registry.clone();
        let opened = spawn_blocking({
            let folder = experiments.clone();
            move || ExperimentManager::open(&folder, threads, quota_bytes, registry)
        });
        let opened = opened.await.expect("opening does not panic");
        let experiments = opened.map_err(folder_error(&experiments))?;
        let (registry, quota_bytes) = (core.registry.clone(), config.recordings_quota_bytes);
        let opened = Recordings::open(&recordings, quota_bytes, registry);
        let recordings = opened.map_err(folder_error(&recordings))?;
        let uploads = Uploads::open(&replays).map_err(folder_error(&replays))?;
        Ok(Files {
            experiments,
            recordings,
            uploads: Arc::new(uploads),
        })
    }
}

fn folder_error(folder: &Path) -> impl FnOnce(std::io::Error) -> ServerError {
    move |error| ServerError::Folder {
        folder: folder.display().to_string(),
        error,
    }
}

/// The state that all request handlers share.
fn context(
    config: &Config,
    core: &Core,
    files: &Files,
    url: Option<String>,
    (watch, recovery): (Arc<OnceLock<Arc<HealthMonitor>>>, Arc<RecoveryProgress>),
) -> Arc<Context> {
    Arc::new(Context {
        prefix: config.prefix.clone(),
        node: config.node.clone(),
        http: url,
        data_id: core.store.data_id().map(str::to_owned),
        max_clients: config.max_clients,
        max_message_bytes: session::MAX_MESSAGE_BYTES - session::MAX_FRAMING_BYTES,
        peers: Arc::new(Connections {
            session: core.session.clone(),
            claims: core.claims.clone(),
            waits: core.waits.clone(),
        }),
        tokens: Arc::new(core.tokens.clone()),
        token_waits: Default::default(),
        registry: core.registry.clone(),
        replies: core.replies.clone(),
        rights: core.rights.clone(),
        started: Instant::now(),
        store: core.store.clone(),
        idempotency: core.idempotency.clone(),
        schemas: queries::schemas(),
        experiments: files.experiments.clone(),
        uploads: files.uploads.clone(),
        recordings: files.recordings.clone(),
        watch,
        recovery,
        lanes: core.lanes.clone(),
        verifications: Arc::default(),
        limits: UserLimits::new(
            core.store.clone(),
            config.quota_bytes,
            config.auth_dir.is_some(),
        ),
        audit: core.audit.clone(),
    })
}

/// Starts the dispatcher thread, and returns its activity for the health checks.
fn start_dispatcher(
    config: &Config,
    core: &Core,
    context: Arc<Context>,
    received: Receiver<DispatchMessage>,
) -> Result<Arc<Activity>, ServerError> {
    let gateway = Arc::new(gateway::Gateway {
        context,
        claims: core.claims.clone(),
        messages: core.messages.clone(),
        admission: Admission::default(),
        queued: AtomicUsize::new(0),
        open: core.open.clone(),
    });
    let activity = Arc::new(Activity::default());
    let dispatcher = Dispatcher {
        gateway: gateway.clone(),
        pool: core.pool.clone(),
        publisher: core.publisher.clone(),
        endpoints: SwarmEndpoints::new(
            core.session.clone(),
            core.pool.clone(),
            config.prefix.clone(),
            config.node.clone(),
            gateway,
        ),
        held: Vec::new(),
        recovered: None,
        activity: activity.clone(),
    };
    thread::Builder::new()
        .name("dispatch".into())
        .spawn(move || dispatcher.run(&received))?;
    Ok(activity)
}

fn start_watch(
    core: &Core,
    files: &Files,
    bus: Arc<BusWatch>,
    dispatch: Arc<Activity>,
    endpoints: Vec<String>,
    (recovery, other_data): (Arc<RecoveryProgress>, Option<String>),
) -> Result<Arc<HealthMonitor>, ServerError> {
    let (session, claims) = (core.session.clone(), core.claims.clone());
    let replies = core.replies.clone();
    let watched = HealthSources {
        registry: core.registry.clone(),
        store: core.store.clone(),
        rights: core.rights.clone(),
        recordings: files.recordings.clone(),
        experiments: files.experiments.clone(),
        lanes: core.lanes.clone(),
        threads: vec![
            ("dispatch", dispatch),
            ("publish", core.publisher.activity.clone()),
            ("replies", core.replies.activity.clone()),
        ],
        endpoints,
        sessions: Box::new(move || session.info().transports().wait().count()),
        bus: Box::new(move || bus.report()),
        count: commands::count,
        dropped_requests: Box::new(move || replies.dropped()),
        other_data,
        recovery,
        contested: Box::new(move || {
            let contests = claims.contests();
            contests.iter().map(Contest::for_health).collect()
        }),
    };
    Ok(HealthMonitor::start(watched)?)
}

/// How HTTP clients prove that they may send commands: by the token of the page, or as users.
fn credentials(config: &Config, core: &Core) -> Result<Credentials, ServerError> {
    Ok(match core.rights.current().users() {
        None => Credentials::PageToken(Token::of(&config.data_dir).map_err(ServerError::Token)?),
        Some(_) => Credentials::Users(core.rights.clone()),
    })
}

/// Reads the replies and the swarms of the previous run, and opens the keys of these swarms and of the
/// daemon, on which requests get `busy` until they are recovered.
async fn open_recovering(
    core: &Core,
    recovery: &RecoveryProgress,
) -> Result<recovery::Stored, ServerError> {
    let (store, idempotency) = (core.store.clone(), core.idempotency.clone());
    let stored = spawn_blocking(move || recovery::read(&store, &idempotency)).await;
    let stored = stored.expect("reading does not panic");
    let stored = stored.map_err(ServerError::Recovery)?;
    let names: Vec<_> = stored.iter().map(|(name, _)| name.clone()).collect();
    recovery.begin(names.iter().cloned());
    let (opened, result) = sync_channel(1);
    let _ = core
        .messages
        .send(DispatchMessage::Recovering(names, opened));
    let _ = spawn_blocking(move || result.recv()).await;
    Ok(stored)
}

/// Recovers the swarms, each of which resumes its recordings before it continues.
async fn recover(
    core: &Core,
    recordings: &Recordings,
    stored: recovery::Stored,
    progress: Arc<RecoveryProgress>,
) -> Result<(), ServerError> {
    let (registry, store) = (core.registry.clone(), core.store.clone());
    let (idempotency, recordings) = (core.idempotency.clone(), recordings.clone());
    let tokens = core.tokens.clone();
    let has_users = core.rights.current().users().is_some();
    let recovered = spawn_blocking(move || -> Result<(), StoreError> {
        let resume = recordings.clone();
        let on_recovered: OnRecovered = Arc::new(move |handle, now, resets| {
            let resets: Vec<_> = resets.iter().map(|it| Position::from(*it)).collect();
            resume.resume(handle, now, &resets);
            tokens.controllers(&handle.output.name)
        });
        recovery::recover(
            &registry,
            &store,
            &idempotency,
            stored,
            &on_recovered,
            (has_users, &progress),
        );
        let stored = store.swarms()?;
        recordings.end_interrupted(|swarm| stored.iter().any(|(name, _)| name == swarm));
        Ok(())
    });
    let recovered = recovered.await.expect("recovery does not panic");
    recovered.map_err(ServerError::Recovery)
}

/// Ends the recovery, and has the dispatcher declare the daemon's token. Returns once it is declared, or once
/// it is known that another daemon of this name serves.
async fn announce_node(messages: &SyncSender<DispatchMessage>) -> Result<(), ServerError> {
    let (opened, result) = sync_channel(1);
    let _ = messages.send(DispatchMessage::Recovered(opened));
    match spawn_blocking(move || result.recv()).await {
        Ok(Ok(Err(error))) => Err(keys_error(&error)),
        _ => Ok(()),
    }
}

fn keys_error(error: &zenoh::Error) -> ServerError {
    ServerError::Keys(error.to_string())
}
