//! What only a daemon may say never arrives when somebody else says it.

use std::time::Duration;

use jostle_proto::{ErrorCode, keys};
use serde_json::json;
use zenoh::Wait;
use zenoh::sample::Sample;

use super::{Lab, Proof, Visitor};
use crate::support::{NODE, PREFIX, until};

/// Every message that only the daemon sends is tried by everybody who may least to most.
#[tokio::test(flavor = "multi_thread")]
async fn forged_states_answers_and_tokens_never_arrive() {
    let lab = Lab::open().await;
    let victor = lab.enter("victor").await;
    let olga = lab.enter("olga").await;
    olga.create("s").await;
    let (heard, hearing) = flume();
    let keys_heard = ["jostle/**", "jostle/@node/**", "jostle/*/event/@adv/**"];
    let mut listening = Vec::new();
    for key in keys_heard {
        let heard = heard.clone();
        let subscriber = victor
            .session
            .declare_subscriber(key)
            .callback(move |sample: Sample| {
                let text = sample.payload().to_bytes().into_owned();
                if text.starts_with(b"forged") {
                    heard.lock().unwrap().push(sample.key_expr().to_string());
                }
            });
        listening.push(subscriber.await.unwrap());
    }
    let mut cells = 0;
    for name in ["vera", "cleo", "olga"] {
        let forger = lab.enter(name).await;
        let told = [
            keys::state(PREFIX, "s"),
            keys::order(PREFIX, "s"),
            keys::event(PREFIX, "s"),
            keys::state(PREFIX, "another"),
            keys::alive(PREFIX, "s", NODE),
            keys::experiment(PREFIX, NODE, "e", "progress"),
            keys::get(PREFIX, "s", "status"),
            keys::cmd(PREFIX, "s", "pause"),
            keys::node_alive(PREFIX, NODE),
            format!("{}/@adv/pub/0/0/_", keys::event(PREFIX, "s")),
        ];
        for key in &told {
            forger.session.put(key, "forged").await.unwrap();
            forger.session.delete(key).await.unwrap();
            cells += 2;
        }
        let answered = [
            keys::state(PREFIX, "s"),
            keys::get(PREFIX, "s", "status"),
            keys::cmd(PREFIX, "s", "pause"),
            keys::node_get(PREFIX, NODE, "hello"),
            keys::node_cmd(PREFIX, NODE, "create"),
            "jostle/**".to_owned(),
        ];
        let mut posing = Vec::new();
        for key in &answered {
            let posed = forger.session.declare_queryable(key).callback(|query| {
                let key = query.key_expr().clone();
                let _ = query.reply(key, "forged").wait();
            });
            posing.push(posed.await.unwrap());
            cells += 1;
        }
        let mut tokens = Vec::new();
        let alive = [
            keys::alive(PREFIX, "another", NODE),
            keys::node_alive(PREFIX, "another"),
            keys::ctl_alive(PREFIX, "s", "carl"),
            keys::claim(PREFIX, "s", "another", "0", "changed"),
            keys::node_claim(PREFIX, NODE, "0", "changed"),
        ];
        // An operator may hold the token of any controller, and a router that connects as one
        // brings the claims of other daemons.
        let alive = &alive[..if name == "olga" { 2 } else { 5 }];
        for key in alive {
            tokens.push(
                forger
                    .session
                    .liveliness()
                    .declare_token(key)
                    .await
                    .unwrap(),
            );
            cells += 1;
        }
        // What is sent in order over one session has come to its end when this is answered, which
        // the forger itself would not.
        forger
            .ok(&keys::node_get(PREFIX, NODE, "status"), None)
            .await;
        for key in &answered[..4] {
            let answers = victor
                .session
                .get(key)
                .timeout(Duration::from_secs(5))
                .await
                .unwrap();
            while let Ok(answer) = answers.recv_async().await {
                if let Ok(sample) = answer.result() {
                    let text = sample.payload().to_bytes();
                    assert!(!text.starts_with(b"forged"), "{name} answers {key}");
                }
            }
        }
        for key in alive {
            let there = victor.session.liveliness().get(key).await.unwrap();
            assert!(there.recv_async().await.is_err(), "{name} holds {key}");
        }
        forger.session.close().await.unwrap();
    }
    // By now whatever arrives would have: what the daemon says after it does.
    let before = frames(&victor).await;
    olga.cmd("s", "step", json!({"steps": 2})).await;
    until("the daemon's own states arrive", async || {
        frames(&victor).await > before
    })
    .await;
    assert_eq!(*hearing.lock().unwrap(), Vec::<String>::new());
    println!("{cells} cells");
    drop(listening);
    lab.close(vec![victor, olga]).await;
}

type Heard = std::sync::Arc<std::sync::Mutex<Vec<String>>>;

fn flume() -> (Heard, Heard) {
    let heard = Heard::default();
    (heard.clone(), heard)
}

async fn frames(visitor: &Visitor) -> u64 {
    let key = keys::state(PREFIX, "s") + "?format=json";
    visitor.ok(&key, None).await["step"].as_u64().unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn set_points_are_taken_from_whom_the_controller_is() {
    let lab = Lab::open().await;
    let (vera, cleo, carl, olga) = (
        lab.enter("vera").await,
        lab.enter("cleo").await,
        lab.enter("carl").await,
        lab.enter("olga").await,
    );
    olga.create("s").await;
    let join = json!({"controller": "cleo", "select": {"ids": [1]}, "mode": "free_running",
        "deadline_secs": 10.0});
    cleo.cmd("s", "join", join).await;
    olga.cmd("s", "run", json!({"rate": 1.0})).await;
    let key = keys::ctl(PREFIX, "s", "cleo");
    let put = |sequence: u64| {
        let set = json!({"ids": [1], "direction": [0.5], "weight": [1.0]});
        json!({"sequence": sequence, "set": set}).to_string()
    };
    let taken = async || {
        let told = olga.ok(&keys::get(PREFIX, "s", "controllers"), None).await;
        let puts = told["result"]["controllers"][0]["puts"].clone();
        let counts = puts.as_object().unwrap().values();
        counts.map(|count| count.as_u64().unwrap()).sum::<u64>()
    };
    let json = zenoh::bytes::Encoding::APPLICATION_JSON;
    for stranger in [&vera, &carl] {
        stranger
            .session
            .put(&key, put(1))
            .encoding(json.clone())
            .await
            .unwrap();
        stranger
            .ok(&keys::node_get(PREFIX, NODE, "hello"), None)
            .await;
    }
    for (number, own) in [(2, &cleo), (3, &olga)] {
        own.session
            .put(&key, put(number))
            .encoding(json.clone())
            .await
            .unwrap();
        until("set-points are taken", async || taken().await == number - 1).await;
    }
    lab.close(vec![vera, cleo, carl, olga]).await;
}

/// A router brings the claims of other daemons, and a client can connect as a router.
#[tokio::test(flavor = "multi_thread")]
async fn only_a_router_of_an_operator_brings_claims() {
    let lab = Lab::open().await;
    let olga = lab.enter("olga").await;
    olga.create("s").await;
    for name in ["vera", "cleo", "olga"] {
        let proof = Proof::of(&lab.folder, name);
        let router = proof.open_as("router", lab.endpoint("tls")).await.unwrap();
        let mut tokens = Vec::new();
        for key in [
            keys::claim(PREFIX, "s", "another", "0", "changed"),
            keys::node_claim(PREFIX, NODE, "0", "changed"),
        ] {
            let token = router.liveliness().declare_token(key);
            tokens.push(token.await.unwrap());
        }
        let key = keys::node_get(PREFIX, NODE, "metrics");
        let mut contested = 0;
        for _ in 0..100 {
            for answer in olga.ask(&key, None).await {
                match answer {
                    Ok(reply) => contested += reply["result"]["contested"].as_u64().unwrap(),
                    Err(error) => {
                        assert_eq!(error.code, ErrorCode::Contested);
                        contested += 1;
                    }
                }
            }
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        assert_eq!(contested > 0, name == "olga", "{name}: {contested}");
        if name != "olga" {
            olga.cmd("s", "step", json!({"steps": 1})).await;
        }
        router.close().await.unwrap();
    }
    lab.close(vec![olga]).await;
}
