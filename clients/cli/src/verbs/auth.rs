//! `auth`: the identity and the permissions of this client.

use std::net::IpAddr;

use jostle_client::{Client, ConnectOptions};
use jostle_proto::role::rejection;
use jostle_proto::{Hello, NodeReply, WhoAmI};
use serde_json::Value;

use crate::arguments::{AuthVerb, GlobalArguments, READS};
use crate::context::Context;
use crate::failure::Failure;
use crate::output::Output;

/// Executes a verb of `auth`.
pub async fn auth(context: &Context, what: &AuthVerb) -> Result<(), Failure> {
    let Context { client, output } = context;
    if let AuthVerb::Link { .. } = what {
        let token = required(client.token())?;
        return output.data(&link(&page_of(client).await?, token));
    }
    let answer = client.get_node("whoami").await?;
    let NodeReply { node, result: who } = answer.read::<NodeReply<WhoAmI>>()?;
    match what {
        AuthVerb::Can { verb } => {
            let is_read = READS.contains(&verb.as_str()) && who.role.is_some();
            if !is_read && !who.verbs.contains(verb) && !who.node_verbs.contains(verb) {
                let person = who.person.as_deref().zip(who.role);
                return Err(Failure::rejected(rejection(person, verb)));
            }
            output.reply(&answer, |_: &Value| format!("you may {verb}"))
        }
        _ => output.reply(&answer, |_: &Value| {
            describe(&node, &who, client.token().is_some())
        }),
    }
}

/// Describes the identity and the permissions.
fn describe(node: &str, who: &WhoAmI, has_token: bool) -> String {
    let may = |verbs: &[String]| match verbs {
        [] => "nothing".to_owned(),
        verbs => verbs.join(", "),
    };
    let first = match (&who.person, who.role) {
        (Some(person), Some(role)) => format!("{person}, {role} on {node}"),
        (None, Some(_)) => format!("{node} has no authentication: every client may do everything"),
        _ if has_token => format!("not a user of {node}: these credentials are out of date"),
        _ => format!("not a user of {node}: pass your credentials, --credentials FOLDER"),
    };
    format!(
        "{first}\nof swarms: watch{}{}\nof the daemon: {}",
        if who.verbs.is_empty() { "" } else { ", " },
        who.verbs.join(", "),
        may(&who.node_verbs)
    )
}

/// Prints the link to a page whose address is given. It needs no daemon, which admits a new user over zenoh
/// only after a restart.
pub fn link_to(output: Output, global: &GlobalArguments, page: &str) -> Result<(), Failure> {
    let token = ConnectOptions::from(global).token()?;
    let token = required(token.as_deref())?;
    output.data(&link(page.trim_end_matches('/'), token))
}

/// The link to the page. It contains the token, so no other verb prints it.
fn link(page: &str, token: &str) -> String {
    format!("{page}/#token={token}")
}

fn required(token: Option<&str>) -> Result<&str, Failure> {
    token.ok_or_else(|| {
        let problem = "is required: the link contains the token of the credentials";
        Failure::argument("--credentials", problem)
    })
}

/// The HTTP URL that the daemon reports, with a host that is reachable from this machine.
async fn page_of(client: &Client) -> Result<String, Failure> {
    let answer = client.get_node("hello").await?;
    let hello: NodeReply<Hello> = answer.read()?;
    let served = hello.result.http.ok_or_else(|| {
        Failure::argument(
            "--page",
            "is required, since the daemon reports no HTTP address (it serves none, or its version \
             is older): start it with --http ADDRESS",
        )
    })?;
    Ok(reached_by(&served, client.page(), client.endpoint()))
}

/// Replaces the host of the served URL by one that is reachable from this machine: the host in the
/// credentials if scheme and port are equal, and the host of the zenoh endpoint for a wildcard
/// address.
fn reached_by(served: &str, page: Option<&str>, endpoint: &str) -> String {
    let parts = |url: &str| {
        let (scheme, address) = url.split_once("://")?;
        let (host, port) = address.rsplit_once(':')?;
        Some((scheme.to_owned(), host.to_owned(), port.to_owned()))
    };
    let Some((scheme, host, port)) = parts(served) else {
        return served.to_owned();
    };
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    let is_everywhere = bare.parse::<IpAddr>().is_ok_and(|it| it.is_unspecified());
    if !is_everywhere {
        return served.to_owned();
    }
    let named = page
        .and_then(parts)
        .filter(|(its_scheme, _, its_port)| (its_scheme, its_port) == (&scheme, &port));
    let connected = || {
        let (protocol, address) = endpoint.split_once('/')?;
        let address = address.split(['?', '#']).next()?;
        let (host, _) = address.rsplit_once(':')?;
        (protocol != "unixsock-stream").then(|| host.to_owned())
    };
    let host = named.map(|(_, host, _)| host).or_else(connected);
    format!(
        "{scheme}://{}:{port}",
        host.as_deref().unwrap_or("127.0.0.1")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_named_as_it_is_reached() {
        let tls = "tls/lab.example:7447";
        let page = Some("https://page.example:8443");
        for (served, page, endpoint, link) in [
            (
                "http://127.0.0.1:40001",
                page,
                tls,
                "http://127.0.0.1:40001",
            ),
            ("https://10.0.0.5:1", None, tls, "https://10.0.0.5:1"),
            (
                "https://0.0.0.0:8443",
                page,
                tls,
                "https://page.example:8443",
            ),
            (
                "https://0.0.0.0:8444",
                page,
                tls,
                "https://lab.example:8444",
            ),
            (
                "https://[::]:8443",
                None,
                "tls/[fe80::1]:1",
                "https://[fe80::1]:8443",
            ),
            (
                "https://0.0.0.0:1",
                None,
                "unixsock-stream//a:b",
                "https://127.0.0.1:1",
            ),
        ] {
            assert_eq!(reached_by(served, page, endpoint), link, "{served}");
        }
    }
}
