//! Who one is to the daemon.

use std::net::IpAddr;

use jostle_proto::role::refused;
use jostle_proto::{Hello, NodeReply, WhoAmI};

use crate::arguments::AuthVerb;
use crate::bus::Bus;
use crate::failure::Failure;
use crate::output::Output;

/// Says who one is and what one may.
///
/// # Errors
///
/// What the daemon says, or that something is not permitted.
pub async fn auth(bus: &Bus, output: Output, what: &AuthVerb) -> Result<(), Failure> {
    if let AuthVerb::Link { page } = what {
        return link(bus, output, page.as_deref()).await;
    }
    let answer = bus.get_node("whoami").await?;
    let NodeReply { node, result: who } = answer.read::<NodeReply<WhoAmI>>()?;
    match what {
        AuthVerb::Can { verb } => {
            if !who.verbs.contains(verb) && !who.node_verbs.contains(verb) {
                let person = who.person.as_deref().zip(who.role);
                return Err(Failure::refused(refused(person, verb)));
            }
            match output.json {
                true => output.data(answer.json()?),
                false => output.data(&format!("you may {verb}")),
            }
        }
        _ if output.json => output.data(answer.json()?),
        _ => output.data(&told(&node, &who, bus.token().is_some())),
    }
}

/// Who one is, in words.
fn told(node: &str, who: &WhoAmI, has_token: bool) -> String {
    let may = |verbs: &[String]| match verbs {
        [] => "nothing".to_owned(),
        verbs => verbs.join(", "),
    };
    let first = match (&who.person, who.role) {
        (Some(person), Some(role)) => format!("{person}, {role} on {node}"),
        (None, Some(_)) => format!("{node} knows no people: whoever reaches it may do everything"),
        _ if has_token => format!("nobody that {node} knows: these credentials are out of date"),
        _ => format!("nobody that {node} knows: --credentials FOLDER says who you are"),
    };
    format!(
        "{first}\nof swarms: watch{}{}\nof the daemon: {}",
        if who.verbs.is_empty() { "" } else { ", " },
        who.verbs.join(", "),
        may(&who.node_verbs)
    )
}

/// The link to the page, which the token opens. It is what was asked for, and goes nowhere else.
async fn link(bus: &Bus, output: Output, page: Option<&str>) -> Result<(), Failure> {
    let Some(token) = bus.token() else {
        return Err(Failure::Argument {
            argument: "--credentials".into(),
            problem: "is not given, and the token in the link is theirs".into(),
        });
    };
    let page = match page {
        Some(page) => page.trim_end_matches('/').to_owned(),
        None => page_of(bus).await?,
    };
    output.data(&format!("{page}/#token={token}"))
}

/// The HTTP URL that the daemon reports, with a host that is reachable from this machine.
async fn page_of(bus: &Bus) -> Result<String, Failure> {
    let answer = bus.get_node("hello").await?;
    let hello: NodeReply<Hello> = answer.read()?;
    let served = hello.result.http.ok_or_else(|| Failure::Argument {
        argument: "--page".into(),
        problem: "is not given, and the daemon serves no HTTP (or is older than this command \
                  line): start it with --http ADDRESS"
            .into(),
    })?;
    Ok(reached_by(&served, bus.page(), bus.endpoint()))
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
