//! The addresses of a daemon: the endpoints that it listens on, the names in its certificate, and
//! the endpoint and URL in the folders of its users.

use std::net::IpAddr;

use serde::Deserialize;
use toml::{Spanned, Value};

use crate::auth::AuthError;
use crate::auth::folder::{Folder, PeopleFile, file_error, read};

/// The names by which this machine reaches itself.
pub const OWN_NAMES: [&str; 3] = ["localhost", "127.0.0.1", "::1"];

/// The default port and endpoints.
const PORT: u16 = 7447;
const DEFAULT_LISTEN: &str = "tcp/127.0.0.1:7447";
const DEFAULT_HTTP: &str = "127.0.0.1:8080";

/// A change of a daemon's addresses; what is not given stays as it is.
#[derive(Clone, Debug, Default)]
pub struct AddressChange {
    /// Names and addresses by which other machines reach the daemon.
    pub hosts: Vec<String>,
    /// Zenoh endpoints to listen on.
    pub listen: Option<Vec<String>>,
    /// The address for HTTP; empty to serve none.
    pub http: Option<String>,
}

/// The addresses of a daemon.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// Zenoh endpoints that it listens on.
    pub listen: Vec<String>,
    /// The address for HTTP; empty if it serves none.
    pub http: String,
    /// Names and addresses by which other machines reach it.
    pub hosts: Vec<String>,
    /// The endpoint to which clients connect.
    pub endpoint: String,
    /// The URL of the page, if HTTP is served.
    pub page: Option<String>,
}

/// An address and a port; a name in place of the address is kept as it is.
struct HostPort {
    host: String,
    port: u16,
}

impl AddressChange {
    /// Whether it changes anything.
    pub fn is_empty(&self) -> bool {
        self.hosts.is_empty() && self.listen.is_none() && self.http.is_none()
    }
}

impl Address {
    /// The address of `folder` once `reach` is applied; `known` is the present content of `people.json`.
    ///
    /// # Errors
    ///
    /// [`AuthError::AnyPort`] or [`AuthError::NoHost`] if clients could not connect to it.
    pub fn of(
        folder: &Folder,
        known: Option<&PeopleFile>,
        address_change: &AddressChange,
    ) -> Result<Self, AuthError> {
        if let Some(host) = address_change.hosts.iter().find(|host| !is_host(host)) {
            return Err(AuthError::Host(host.clone()));
        }
        let hosts = hosts(known, address_change)?;
        let (listen, http) = match settings(folder)? {
            Some((_, settings)) => {
                let http = settings.http.as_ref();
                let http = http.and_then(|it| it.get_ref().as_str().map(str::to_owned));
                (settings.listen.map(|it| strings(it.get_ref())), http)
            }
            None => {
                let anywhere = if hosts.is_empty() {
                    "127.0.0.1"
                } else {
                    "0.0.0.0"
                };
                (Some(vec![format!("tls/{anywhere}:{PORT}")]), None)
            }
        };
        let listen = address_change.listen.clone().or(listen);
        let listen = listen.unwrap_or_else(|| vec![DEFAULT_LISTEN.to_owned()]);
        let http = address_change.http.clone().or(http);
        let http = http.unwrap_or_else(|| DEFAULT_HTTP.to_owned());
        let is_moved = known.is_none() || !address_change.hosts.is_empty();
        let endpoint = match known {
            Some(known) if !is_moved && address_change.listen.is_none() => known.endpoint.clone(),
            _ => endpoint(&listen, &hosts, is_moved)?,
        };
        let page = match known {
            Some(known) if !is_moved && address_change.http.is_none() => known.page.clone(),
            _ => page(&http, &hosts)?,
        };
        Ok(Address {
            listen,
            http,
            hosts,
            endpoint,
            page,
        })
    }

    /// The names of the daemon's certificate: its own, those by which others reach it, and the
    /// addresses that it listens on.
    pub fn names(&self) -> Vec<String> {
        let own = OWN_NAMES.map(str::to_owned);
        let listened = self.listen.iter().filter_map(|it| it.strip_prefix("tls/"));
        let served = self.http.strip_prefix("https://");
        let places = listened.chain(served).filter_map(HostPort::read);
        let addresses = places
            .filter(|place| !place.is_everywhere())
            .map(|it| it.host);
        let mut names: Vec<String> = Vec::new();
        for name in own
            .into_iter()
            .chain(self.hosts.iter().cloned())
            .chain(addresses)
        {
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }

    /// Whether clients would connect by the name of a machine, but the daemon listens on loopback
    /// only.
    pub fn is_out_of_reach(&self) -> bool {
        let is_local = |endpoint: &String| {
            let place = endpoint
                .split_once('/')
                .and_then(|(_, it)| HostPort::read(it));
            place.is_none_or(|it| it.is_local())
        };
        !is_local(&self.endpoint) && self.listen.iter().all(is_local)
    }

    /// Writes the settings that a daemon starts with; in an existing file only what `reach` changes.
    pub fn write_settings(
        &self,
        folder: &Folder,
        address_change: &AddressChange,
    ) -> Result<(), AuthError> {
        let written = settings(folder)?;
        let listen = match &self.listen[..] {
            [one] => format!("{one:?}"),
            several => format!("{several:?}"),
        };
        let http = format!("{:?}", self.http);
        let text = match written {
            None => {
                let path = folder.path().canonicalize();
                let path = path.map_err(|error| file_error(folder.path(), error))?;
                let http = address_change
                    .http
                    .as_ref()
                    .map(|_| format!("http = {http}\n"));
                let http = http.unwrap_or_default();
                format!("listen = {listen}\n{http}auth_dir = {path:?}\n")
            }
            Some((mut text, settings)) => {
                let mut changes = Vec::new();
                let old = settings.listen.as_ref();
                let is_same = old.is_some_and(|old| strings(old.get_ref()) == self.listen);
                if address_change.listen.is_some() && !is_same {
                    changes.push(("listen", settings.listen, listen));
                }
                if address_change.http.is_some() {
                    changes.push(("http", settings.http, http));
                }
                // From the end, so that earlier spans stay valid.
                changes.sort_by_key(|(_, old, _)| old.as_ref().map(|old| old.span().start));
                for (name, old, new) in changes.into_iter().rev() {
                    match old {
                        Some(old) => text.replace_range(old.span(), &new),
                        None => text.insert_str(0, &format!("{name} = {new}\n")),
                    }
                }
                text
            }
        };
        folder.write_settings(&text)
    }
}

impl HostPort {
    /// Reads `127.0.0.1:7447`, `[::1]:7447`, `lab.example:7447`, followed by zenoh's `#iface=…`.
    fn read(address: &str) -> Option<Self> {
        let address = address.split(['?', '#']).next()?;
        let (host, port) = address.rsplit_once(':')?;
        Some(HostPort {
            host: without_brackets(host).to_owned(),
            port: port.parse().ok()?,
        })
    }

    fn is_local(&self) -> bool {
        is_loopback(&self.host)
    }

    /// Whether it is every address of the machine.
    fn is_everywhere(&self) -> bool {
        let address = self.host.parse::<IpAddr>();
        self.host == "*" || address.is_ok_and(|it| it.is_unspecified())
    }

    /// The host and port by which clients connect.
    fn client_address(&self, given: &str, host: Option<&String>) -> Result<String, AuthError> {
        if self.port == 0 {
            return Err(AuthError::AnyPort(given.to_owned()));
        }
        let host = match host {
            Some(host) => host,
            None if self.is_everywhere() => return Err(AuthError::NoHost(given.to_owned())),
            None => &self.host,
        };
        Ok(match host.contains(':') {
            true => format!("[{host}]:{}", self.port),
            false => format!("{host}:{}", self.port),
        })
    }
}

/// Whether a host is a name or an address of the loopback interface.
pub fn is_loopback(host: &str) -> bool {
    let address = without_brackets(host).parse::<IpAddr>();
    host.eq_ignore_ascii_case("localhost") || address.is_ok_and(|it| it.is_loopback())
}

/// An IPv6 address without its brackets; another host as it is.
fn without_brackets(host: &str) -> &str {
    let stripped = host.strip_prefix('[').and_then(|it| it.strip_suffix(']'));
    stripped.unwrap_or(host)
}

/// The names by which other machines reach the daemon.
fn hosts(
    known: Option<&PeopleFile>,
    address_change: &AddressChange,
) -> Result<Vec<String>, AuthError> {
    if !address_change.hosts.is_empty() {
        return Ok(address_change.hosts.clone());
    }
    let Some(known) = known else {
        return Ok(Vec::new());
    };
    // Earlier versions recorded the first name only, as part of the endpoint.
    let place = known.endpoint.strip_prefix("tls/").and_then(HostPort::read);
    match (&known.hosts, place) {
        (Some(hosts), _) => Ok(hosts.clone()),
        (None, Some(place)) if !place.is_local() => Err(AuthError::HostsUnknown(place.host)),
        _ => Ok(Vec::new()),
    }
}

/// The endpoint to which clients connect: the first one over TLS, by the first name of the daemon.
fn endpoint(listen: &[String], hosts: &[String], is_moved: bool) -> Result<String, AuthError> {
    let over_tls = listen.iter().find(|it| it.starts_with("tls/"));
    let Some(given) = over_tls.or(listen.first()) else {
        return Ok(DEFAULT_LISTEN.to_owned());
    };
    let without_options = given.split('#').next().unwrap_or(given);
    let (protocol, address) = without_options.split_once('/').unwrap_or_default();
    if protocol == "unixsock-stream" {
        return Ok(without_options.to_owned());
    }
    let place = HostPort::read(address).ok_or_else(|| AuthError::NoPort(given.clone()))?;
    let by_name = protocol == "tls" && (is_moved || !place.is_local());
    let host = hosts.first().filter(|_| by_name);
    Ok(format!("{protocol}/{}", place.client_address(given, host)?))
}

/// The URL of the page: over TLS by the first name of the daemon.
fn page(http: &str, hosts: &[String]) -> Result<Option<String>, AuthError> {
    let (scheme, address) = match http.split_once("://") {
        Some((scheme, address)) => (scheme, address),
        None => ("http", http),
    };
    let Some(place) = HostPort::read(address) else {
        return Ok(None);
    };
    let by_name = scheme == "https" && !place.is_local();
    let host = hosts.first().filter(|_| by_name);
    Ok(Some(format!(
        "{scheme}://{}",
        place.client_address(http, host)?
    )))
}

/// The addresses in the settings file, with their positions.
#[derive(Deserialize)]
struct Settings {
    listen: Option<Spanned<Value>>,
    http: Option<Spanned<Value>>,
}

/// The settings file in the folder, if there is one: its text, and the addresses in it.
fn settings(folder: &Folder) -> Result<Option<(String, Settings)>, AuthError> {
    let path = folder.settings_file();
    if !path.exists() {
        return Ok(None);
    }
    let text = read(&path)?;
    match toml::from_str(&text) {
        Ok(settings) => Ok(Some((text, settings))),
        Err(error) => Err(AuthError::Content {
            path,
            problem: error.to_string(),
        }),
    }
}

/// The strings of a list, or of a string with commas.
fn strings(value: &Value) -> Vec<String> {
    let parts: Vec<&str> = match value {
        Value::Array(values) => values.iter().filter_map(Value::as_str).collect(),
        value => value.as_str().unwrap_or_default().split(',').collect(),
    };
    let parts = parts.into_iter().map(|it| it.trim().to_owned());
    parts.filter(|it| !it.is_empty()).collect()
}

/// Whether it is an IP address, or a name of letters, digits and hyphens between dots.
fn is_host(host: &str) -> bool {
    let is_label = |label: &str| {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-';
        !label.is_empty() && label.len() <= 63 && label.chars().all(plain)
    };
    let mut labels = host.split('.');
    // A name whose last label is a number is an invalid IP address.
    let is_number = |label: &str| label.bytes().all(|c| c.is_ascii_digit());
    let is_name = labels.clone().all(is_label) && !labels.next_back().is_some_and(is_number);
    host.parse::<IpAddr>().is_ok() || (host.len() <= 253 && is_name)
}
