//! `jostled auth`: users, their roles, and the address of the daemon.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Subcommand;
use jostle_proto::Role;
use serde_json::json;

use crate::auth::AuthError;
use crate::auth::address::AddressChange;
use crate::auth::folder::{Folder, PeopleFile};
use crate::auth::issue::{self, ChangedAddresses, SetUp};
use crate::cli::{fail, print};
use crate::config::{self, Resolved, Source};
use crate::transport::http;
use crate::transport::zenoh::session;

/// The commands below `auth`.
#[derive(Subcommand)]
pub enum Auth {
    /// Create what is missing: a private certificate authority, the daemon's certificate, users.
    ///
    /// `--listen` and `--http` are written into the settings file that it creates.
    Init {
        /// Host name or address by which other machines reach the daemon; repeat it for each, and give
        /// all of them each time: a new certificate is issued for these.
        #[arg(long = "host", value_name = "HOST")]
        hosts: Vec<String>,
        /// Users and their roles: viewer, controller or operator.
        #[arg(value_name = "NAME=ROLE", value_parser = person)]
        people: Vec<(String, Role)>,
    },
    /// Change the address of the daemon, or show it without options.
    ///
    /// `--listen` and `--http` change the settings file (`--config`, or else the one in the folder),
    /// `--host` the names. The same authority issues
    /// a new certificate for the daemon, and the users' folders are rewritten.
    Address {
        /// Host name or address by which other machines reach the daemon; repeat it for each, and give
        /// all of them each time.
        #[arg(long = "host", value_name = "HOST")]
        hosts: Vec<String>,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Add users; a running daemon accepts their tokens within 5 s.
    Add {
        /// Users and their roles: viewer, controller or operator.
        #[arg(value_name = "NAME=ROLE", value_parser = person, required = true)]
        people: Vec<(String, Role)>,
    },
    /// Remove users; a running daemon rejects their tokens within 5 s.
    Remove {
        /// Users to remove.
        #[arg(value_name = "NAME", required = true)]
        names: Vec<String>,
    },
    /// List the users, their roles and when their certificates expire.
    List {
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
}

/// Runs `jostled auth`; `config` is the settings file that is given.
pub fn run(resolved: &Resolved, config: Option<&PathBuf>, command: &Auth) -> ExitCode {
    let set = |name: &str| match &resolved[name] {
        (_, Source::Default) => None,
        (text, _) => Some(text.trim().to_owned()),
    };
    let is_flag = |name: &str| matches!(resolved[name].1, Source::Flag(_));
    let address_change = AddressChange {
        hosts: Vec::new(),
        listen: set("listen").map(|listen| config::endpoints(&listen)),
        http: set("http"),
    };
    let is_change = is_flag("listen") || is_flag("http");
    if let Some(listen) = &address_change.listen {
        if listen.is_empty() {
            return fail(2, &"--listen takes at least one endpoint");
        }
        if let Err(error) = session::check(listen, true) {
            return fail(2, &error);
        }
    }
    if let Some(http) = &address_change.http
        && let Err(error) = http::check(http, true)
    {
        return fail(2, &error);
    }
    match execute(
        resolved["auth_dir"].0.trim(),
        config,
        &address_change,
        is_change,
        command,
    ) {
        Ok(output) => print(&output),
        Err((code, problem)) => fail(code, &problem),
    }
}

/// Returns the output, or an exit code and the error message. `is_change`: whether a flag of this command
/// is in `address_change`.
fn execute(
    folder: &str,
    config: Option<&PathBuf>,
    address_change: &AddressChange,
    is_change: bool,
    command: &Auth,
) -> Result<String, (u8, String)> {
    if folder.is_empty() {
        let problem = "no folder: set auth_dir, or use --auth-dir FOLDER";
        return Err((2, problem.to_owned()));
    }
    let mut folder = Folder::new(PathBuf::from(folder));
    if let (Auth::Address { .. }, Some(file)) = (command, config) {
        folder = folder.with_settings(file.clone());
    }
    let address_change = |hosts: &[String]| AddressChange {
        hosts: hosts.to_owned(),
        ..address_change.clone()
    };
    let done = match command {
        Auth::Init { hosts, people } => issue::set_up(&folder, &address_change(hosts), people)
            .map(|it| set_up_text(&it, &folder)),
        Auth::Address { hosts, json } if hosts.is_empty() && !is_change => {
            folder.people().map(|known| addresses_text(&known, *json))
        }
        Auth::Address { hosts, json } => issue::readdress(&folder, &address_change(hosts))
            .map(|it| change_text(&it, &folder, *json)),
        Auth::Add { people } => issue::add(&folder, people).map(|it| folders_text(&it)),
        Auth::Remove { names } => issue::remove(&folder, names).and_then(|()| {
            let is_last = folder.people()?.people.is_empty();
            Ok(removal_text(names, is_last))
        }),
        Auth::List { json } => folder.people().map(|known| people_text(&known, *json)),
    };
    let is_argument = |error: &AuthError| {
        matches!(
            error,
            AuthError::NoHost(_)
                | AuthError::AnyPort(_)
                | AuthError::NoPort(_)
                | AuthError::HostsUnknown(_)
                | AuthError::Duplicate(_)
        )
    };
    done.map_err(|error| (if is_argument(&error) { 2 } else { 1 }, error.to_string()))
}

/// The output of `list`.
fn people_text(known: &PeopleFile, as_json: bool) -> String {
    let people = known.people.iter();
    if as_json {
        let people: Vec<_> = people
            .map(|it| json!({"person": it.person, "role": it.role, "until": it.until}))
            .collect();
        let text = json!({"people": people, "daemon_until": known.until});
        return format!("{text}\n");
    }
    let until = |day: &Option<String>| {
        let text = day.as_ref().map(|day| format!("until {day}"));
        text.unwrap_or_default()
    };
    let line = |what: &str, who: &str, day| {
        let line = format!("{what:12} {who:20} {}", until(day));
        format!("{}\n", line.trim_end())
    };
    let all: String = people
        .map(|it| line(it.role.name(), &it.person, &it.until))
        .collect();
    all + &line("(daemon)", "", &known.until)
}

/// The output of `address` without options.
fn addresses_text(known: &PeopleFile, as_json: bool) -> String {
    if as_json {
        let text = json!({"endpoint": known.endpoint, "page": known.page, "hosts": known.hosts});
        return format!("{text}\n");
    }
    let page = known.page.as_deref().unwrap_or("not recorded");
    let hosts = match &known.hosts {
        Some(hosts) if hosts.is_empty() => "only those of this machine".to_owned(),
        Some(hosts) => hosts.join(", "),
        None => "not recorded".to_owned(),
    };
    let endpoint = &known.endpoint;
    format!("endpoint  {endpoint}\npage      {page}\nnames     {hosts}\n")
}

/// The output after a change of address.
fn change_text(moved: &ChangedAddresses, folder: &Folder, as_json: bool) -> String {
    let address = &moved.address;
    if as_json {
        let text = json!({
            "endpoint": address.endpoint,
            "page": address.page,
            "hosts": address.hosts,
            "listen": address.listen,
            "http": address.http,
            "certificate_names": moved.names,
            "rewritten": moved.rewritten,
            "stale": moved.stale,
        });
        return format!("{text}\n");
    }
    let mut text = format!(
        "endpoint: {}\npage: {}\nnames in the certificate: {}\n",
        address.endpoint,
        address.page.as_deref().unwrap_or("none"),
        moved.names.join(", ")
    );
    if address.is_out_of_reach() {
        text += &format!(
            "the daemon listens on this machine only ({}): to listen for others, run `jostled auth \
             address --listen tls/0.0.0.0:7447`\n",
            address.listen.join(", ")
        );
    }
    text += &format!(
        "restart the daemon: it reads its addresses (settings: {}) and its certificate when it \
         starts\n",
        folder.settings_file().display()
    );
    if !moved.rewritten.is_empty() {
        text += "give these folders to their users again; the secrets in them are unchanged:\n";
    }
    for folder in &moved.rewritten {
        text += &format!("  {}\n", folder.display());
    }
    if !moved.stale.is_empty() {
        text += &format!(
            "not found: the folders of {}; these users pass `-e {}` or set JOSTLE_ENDPOINT, or \
             change \"endpoint\" in credentials.json and zenoh.json5\n",
            moved.stale.join(", "),
            address.endpoint
        );
    }
    text
}

/// The output of `remove`.
fn removal_text(names: &[String], is_last: bool) -> String {
    let mut who = names.to_owned();
    who.sort();
    who.dedup();
    let mut text = format!(
        "{}: removed. A running daemon rejects their tokens within 5 s: requests over HTTP, open \
         pages, commands and set-points over zenoh. A zenoh session that is open, or is opened with \
         the old folder, still reads states and events until the daemon is restarted.\n",
        who.join(", ")
    );
    if is_last {
        text += "no users are left: the daemon does not start until `jostled auth add` adds one\n";
    }
    text
}

/// The output of `init`: what it created and what it changed.
fn set_up_text(done: &SetUp, folder: &Folder) -> String {
    match &done.moved {
        None => folders_text(&done.created),
        Some(change) if done.created.is_empty() => change_text(change, folder, false),
        Some(change) => change_text(change, folder, false) + &folders_text(&done.created),
    }
}

/// The output of `add`.
fn folders_text(folders: &[PathBuf]) -> String {
    if folders.is_empty() {
        return "nothing to create; `jostled auth add NAME=ROLE` adds users\n".into();
    }
    let mut text =
        String::from("hand each folder to its user over a secure channel, and delete it here:\n");
    for folder in folders {
        text += &format!("  {}\n", folder.display());
    }
    text += "the user passes it: jostle --credentials FOLDER …\n\
             A running daemon accepts their tokens within 5 s: the page and requests over HTTP. \
             Their zenoh sessions, including those of jostle and Python, need a restart of the daemon.\n";
    text
}

/// Parses `anna=operator`.
fn person(text: &str) -> Result<(String, Role), String> {
    let roles = Role::ALL.map(Role::name).join(", ");
    let (name, role) = text
        .split_once('=')
        .ok_or_else(|| format!("use NAME=ROLE with one of the roles {roles}"))?;
    let role = Role::ALL.into_iter().find(|known| known.name() == role);
    let role = role.ok_or_else(|| format!("unknown role: use one of {roles}"))?;
    Ok((name.to_owned(), role))
}
