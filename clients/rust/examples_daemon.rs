// A daemon for tests and for the examples of the documentation, which include this file.

use std::collections::BTreeMap;

/// A daemon in this process, on a free port and with temporary data.
pub struct Daemon {
    pub server: jostled::app::Server,
    _folder: tempfile::TempDir,
}

impl Daemon {
    pub async fn start() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let server = serve(folder.path(), "tcp/127.0.0.1:0").await;
        Daemon {
            server,
            _folder: folder,
        }
    }

    pub fn endpoint(&self) -> &str {
        &self.server.endpoints[0]
    }
}

pub async fn serve(folder: &std::path::Path, listen: &str) -> jostled::app::Server {
    let settings = BTreeMap::from([
        ("listen", listen),
        ("node", "test"),
        ("http", ""),
        ("data_dir", folder.to_str().expect("UTF-8")),
    ]);
    let settings = jostled::cli::settings::from_flags(settings).expect("settings");
    let config = jostled::config::Config::new(&settings).expect("a configuration");
    jostled::app::start(&config).await.expect("a daemon")
}
