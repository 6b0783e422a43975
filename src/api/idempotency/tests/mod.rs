//! Tests of eviction and of retries.

#![expect(clippy::unwrap_used, reason = "tests")]

use jostle_convert::Place;

use super::*;
use crate::api::incoming::fixture::{LONG, code, request};
use crate::api::responder::Replies;

/// Requests with room for this many of the smallest replies.
fn requests(has_people: bool, count: usize) -> Requests {
    Requests::new(has_people, count * MIN_COST)
}

/// Remembers a reply of this cost, and returns the ids of the requests whose replies it evicts.
fn reply(requests: &mut Requests, client: Option<&str>, id: &str, cost: usize) -> Vec<String> {
    let name = Arc::new((client.map(str::to_owned), id.to_owned()));
    let payload = Payload {
        bytes: vec![b'1'; cost.saturating_sub(REPLY_BYTES)],
        encoding: JSON,
        to_cache: None,
    };
    let (_, evicted) = requests.insert(name, [0; 32], Ok(payload));
    evicted.iter().map(|name| name.1.clone()).collect()
}

fn contains_reply(requests: &Requests, client: Option<&str>, id: &str) -> bool {
    let name = (client.map(str::to_owned), id.to_owned());
    requests.by_name.contains_key(&name)
}

#[test]
fn large_replies_of_one_client_evict_no_reply_of_another() {
    let mut requests = requests(false, 100);
    reply(&mut requests, Some("operator"), "1", 100);
    reply(&mut requests, None, "1", 100);
    for number in 0..500 {
        let id = number.to_string();
        reply(&mut requests, Some("controller"), &id, 10 * MIN_COST);
    }
    assert!(contains_reply(&requests, Some("operator"), "1"));
    assert!(contains_reply(&requests, None, "1"));
    for number in 0..500 {
        let is_kept = contains_reply(&requests, Some("controller"), &number.to_string());
        assert_eq!(is_kept, number >= 491, "{number}");
    }
}

#[test]
fn many_replies_of_one_client_evict_no_reply_of_another() {
    let mut requests = requests(false, 10);
    reply(&mut requests, Some("operator"), "1", 2 * MIN_COST);
    for number in 0..50 {
        reply(&mut requests, Some("controller"), &number.to_string(), 10);
    }
    assert!(contains_reply(&requests, Some("operator"), "1"));
    for number in 0..50 {
        let is_kept = contains_reply(&requests, Some("controller"), &number.to_string());
        assert_eq!(is_kept, number >= 42, "{number}");
    }
}

#[test]
fn beside_n_other_names_a_client_keeps_its_share_of_n_plus_1() {
    let mut requests = requests(false, 100);
    for id in 0..10 {
        reply(&mut requests, Some("operator"), &id.to_string(), 10);
    }
    for id in 0..1000 {
        let name = format!("invented-{}", id % 9);
        reply(&mut requests, Some(&name), &id.to_string(), 10);
    }
    let kept = (0..10).filter(|id| contains_reply(&requests, Some("operator"), &id.to_string()));
    assert_eq!(kept.count(), 10);
    // With as many names as there is room for replies, none of it is kept.
    for id in 0..100 {
        let name = format!("more-{id}");
        reply(&mut requests, Some(&name), &id.to_string(), 10);
    }
    assert!(!(0..10).any(|id| contains_reply(&requests, Some("operator"), &id.to_string())));
}

#[test]
fn the_smallest_replies_are_limited_in_number() {
    const { assert!(MAX_REPLY_BYTES / MIN_COST <= MAX_REPLIES) };
    const { assert!(MAX_REPLY_BYTES / MIN_COST > MAX_REPLIES * 998 / 1000) };
}

#[test]
fn the_clients_of_a_person_are_one_holder_where_people_are_known() {
    for (has_people, evicted) in [(true, "1"), (false, "3")] {
        let mut requests = requests(has_people, 4);
        reply(&mut requests, Some("cleo:a"), "1", 10);
        reply(&mut requests, Some("cleo:b"), "2", 10);
        reply(&mut requests, Some("dora"), "3", 10);
        reply(&mut requests, Some("dora"), "4", 10);
        // Person cleo now has three replies; client cleo:c has one, and dora has two.
        assert_eq!(reply(&mut requests, Some("cleo:c"), "5", 10), [evicted]);
    }
}

#[test]
fn of_holders_of_equally_many_the_one_with_the_oldest_reply_loses_it() {
    let mut requests = requests(false, 3);
    for (client, id) in [("a", "1"), ("c", "2"), ("b", "3")] {
        assert!(reply(&mut requests, Some(client), id, 10).is_empty());
    }
    for (client, id, evicted) in [("d", "4", "1"), ("e", "5", "2"), ("a", "6", "3")] {
        assert_eq!(reply(&mut requests, Some(client), id, 10), [evicted]);
    }
}

#[test]
fn the_newest_reply_stays_however_large_and_goes_next() {
    let mut requests = requests(false, 10);
    for id in ["1", "2", "3"] {
        reply(&mut requests, Some("a"), id, 10);
    }
    let evicted = reply(&mut requests, Some("b"), "4", 20 * MIN_COST);
    assert_eq!(evicted, ["1", "2", "3"]);
    assert!(contains_reply(&requests, Some("b"), "4"));
    assert_eq!(reply(&mut requests, Some("a"), "5", 10), ["4"]);
}

#[test]
fn a_reply_that_replaces_another_takes_its_place() {
    let mut requests = requests(false, 3);
    for id in ["1", "2", "1", "1", "3"] {
        assert!(reply(&mut requests, Some("a"), id, 10).is_empty());
    }
    assert_eq!(reply(&mut requests, Some("a"), "4", 10), ["2"]);
}

#[test]
fn the_totals_are_the_sums_of_the_cached_replies() {
    let mut requests = requests(true, 40);
    let (mut number, mut evicted, mut replaced) = (1_u64, 0, 0);
    for _ in 0..5000 {
        number = number
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        let random = |below: u64, shift: u32| usize::try_from((number >> shift) % below).unwrap();
        let client = format!("p{}:{}", random(9, 33), random(3, 37));
        let client = (random(20, 41) > 0).then_some(client.as_str());
        // Some ids repeat, so that replies are replaced too.
        let id = random(100, 45).to_string();
        replaced += usize::from(contains_reply(&requests, client, &id));
        evicted += reply(&mut requests, client, &id, random(3000, 20)).len();

        let costs = requests.by_name.values().map(|it| match &it.progress {
            Progress::Done(_, reply) => cost(reply),
            Progress::Pending(_) => 0,
        });
        assert_eq!(requests.cost, costs.sum::<usize>());
        let held = requests.holders.values().map(|it| it.replies.len());
        assert_eq!(requests.by_name.len(), held.sum::<usize>());
        let most = requests.holders.values().map(|it| it.cost).max().unwrap();
        let last = requests.ranking.last_key_value().unwrap();
        assert_eq!(last.0.0, most);
        assert_eq!(requests.ranking.len(), requests.holders.len());
        assert!(requests.cost <= requests.max_cost);
    }
    assert_eq!(evicted + replaced + requests.by_name.len(), 5000);
}

#[tokio::test]
async fn a_retry_of_a_request_that_was_dropped_is_not_executed() {
    let folder = tempfile::tempdir().unwrap();
    let settings = store::Settings {
        quota_bytes: 1,
        ..store::Settings::default()
    };
    let store = Store::open(folder.path(), settings, Box::new(|_| {})).unwrap();
    let cache = IdempotencyCache::new(store.clone(), false);
    let sender = Replies::start().unwrap();
    for (id, is_late, first) in [("1", false, "internal"), ("2", true, "busy")] {
        let identity = || RequestIdentity {
            client: None,
            request_id: id.to_owned(),
            digest: [0; 32],
        };
        let (incoming, replies) = request(false);
        let responder = sender.responder(&incoming, "key".into());
        assert!(cache.begin(identity(), &responder).unwrap());
        if is_late {
            // A reply such as that of a deadline, before the result.
            let busy = Payload::json(&CommandError::Busy.to_wire(None, &Place::default()));
            responder.send(move || Err(busy));
        }
        drop(responder);
        assert_eq!(code(replies.recv_timeout(LONG).unwrap()), first);

        let (incoming, replies) = request(false);
        let responder = sender.responder(&incoming, "key".into());
        let is_new = cache.begin(identity(), &responder).unwrap();
        assert!(!is_new, "request {id} is executed again");
        assert_eq!(code(replies.recv_timeout(LONG).unwrap()), "internal");
    }
    // Also after a restart.
    store.commit(Vec::new()).unwrap();
    assert_eq!(store.replies().unwrap().len(), 2);
}
