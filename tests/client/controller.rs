//! A controller in lock-step, and how it resumes after errors.

use std::time::{Duration, Instant};

use jostle_client::{Client, CommandOptions, ConnectOptions, Controller, Error};
use jostle_proto::verbs::{
    CreateArgs, JoinArgs, LeaveArgs, Mode, OnTimeout, RemoveArgs, ResetArgs, Return, Select,
    SetArgs, SetPoints, SetResult,
};
use jostle_proto::{ControllerList, ErrorCode, Phase, Reply, Spec};

use crate::daemon::Daemon;
use crate::follow::Process;

async fn join(client: &Client, name: &str, ids: &[u32]) -> Controller {
    join_with(client, name, Select::Ids(ids.to_vec())).await
}

async fn join_with(client: &Client, name: &str, select: Select) -> Controller {
    let args = JoinArgs {
        controller: name.into(),
        select: Some(select),
        mode: Mode::Lockstep,
        deadline_secs: 60.0,
        on_timeout: OnTimeout::Hold,
        driving: true,
        again: false,
    };
    client.join("school", args).await.unwrap().0
}

async fn school(daemon: &Daemon) -> Client {
    school_at(daemon.endpoint()).await
}

async fn school_at(endpoint: &str) -> Client {
    let client = Client::connect(ConnectOptions::to(endpoint));
    let client = client.await.unwrap();
    let (name, spec, exist_ok) = ("school".to_owned(), Spec::new(6), false);
    let args = CreateArgs {
        name,
        spec,
        exist_ok,
    };
    client.create(&args).await.unwrap();
    client
}

fn towards(ids: &[u32], direction: f64) -> Option<SetPoints> {
    Some(SetPoints {
        ids: ids.to_vec(),
        direction: vec![direction; ids.len()],
        ..SetPoints::default()
    })
}

fn code(error: &Error) -> Option<ErrorCode> {
    match error {
        Error::Rejected(error) => Some(error.code),
        _ => None,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_controller_resumes_after_a_reset_a_removal_and_its_own_departure() {
    let daemon = Daemon::start().await;
    let client = school(&daemon).await;
    let mut ada = join(&client, "ada", &[1, 3, 4]).await;
    ada.advance(2, None, Return::None).await.unwrap();
    let reset = ResetArgs { seed: None };
    client.execute("school", &reset).await.unwrap();
    let error = ada.advance(1, None, Return::None).await.unwrap_err();
    assert_eq!(code(&error), Some(ErrorCode::Conflict), "{error}");
    assert_eq!(ada.sync().await.unwrap().step, 0);
    ada.advance(1, None, Return::None).await.unwrap();

    let select = Select::Ids(vec![3]);
    let remove = RemoveArgs { select };
    client.execute("school", &remove).await.unwrap();
    let set = towards(&[1, 3, 4], 0.5);
    let error = ada.advance(1, set, Return::None).await.unwrap_err();
    assert_eq!(code(&error), Some(ErrorCode::InvalidArgument), "{error}");
    ada.sync().await.unwrap();
    assert_eq!(ada.ids(), [1, 4]);
    let set = towards(&[1, 4], 0.5);
    ada.advance(1, set, Return::None).await.unwrap();

    let leave = LeaveArgs {
        controller: "ada".into(),
    };
    client.execute("school", &leave).await.unwrap();
    let error = ada.advance(1, None, Return::None).await.unwrap_err();
    assert_eq!(code(&error), Some(ErrorCode::NotFound), "{error}");
    let state = ada.sync().await.unwrap();
    assert_eq!((state.step, ada.ids()), (2, [1, 4].as_slice()));
    let reply = ada.advance(1, None, Return::None).await.unwrap();
    assert_eq!(reply.step, 3);
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_advance_ends_within_its_timeout_if_another_controller_does_not_advance() {
    let daemon = Daemon::start().await;
    let client = school(&daemon).await;
    let mut ada = join(&client, "ada", &[1]).await;
    let mut eve = join(&client, "eve", &[2]).await;
    let began = Instant::now();
    let timeout = Duration::from_millis(200);
    let advanced = ada.advance_within(1, None, Return::None, timeout).await;
    let error = advanced.unwrap_err();
    assert_eq!(code(&error), Some(ErrorCode::DeadlineExceeded), "{error}");
    assert!(began.elapsed() < Duration::from_secs(4), "not the client's");
    let (ada, eve) = tokio::join!(
        ada.advance(1, None, Return::None),
        eve.advance(1, None, Return::None)
    );
    assert_eq!((ada.unwrap().step, eve.unwrap().step), (1, 1));
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_set_point_that_is_not_finite_is_rejected_before_it_is_sent() {
    let daemon = Daemon::start().await;
    let client = school(&daemon).await;
    let mut ada = join(&client, "ada", &[1]).await;
    let finite = || towards(&[1], 0.5).unwrap();
    let sets = [
        ("set.direction", towards(&[1], f64::NAN).unwrap()),
        (
            "set.weight",
            SetPoints {
                weight: Some(vec![f64::INFINITY]),
                ..finite()
            },
        ),
        (
            "set.turn",
            SetPoints {
                turn: Some(vec![Some(f64::NAN)]),
                ..finite()
            },
        ),
    ];
    for (field, set) in sets {
        let advanced = ada.advance(1, Some(set), Return::None).await;
        let message = advanced.unwrap_err().to_string();
        assert_eq!(
            message,
            format!("{field}[0] is not finite: give a finite number")
        );
    }
    let model = SetPoints {
        turn: Some(vec![None]),
        ..finite()
    };
    let advanced = ada.advance(1, Some(model), Return::None).await;
    assert_eq!(advanced.unwrap().step, 1);
    client.close().await;
}

/// Drops the future at the latest after so many microseconds; `None` if that was before its end.
async fn within<T>(micros: u64, future: impl Future<Output = T>) -> Option<T> {
    tokio::select! {
        biased;
        outcome = future => Some(outcome),
        () = tokio::time::sleep(Duration::from_micros(micros)) => None,
    }
}

async fn waits_for(client: &Client, name: &str) {
    let began = Instant::now();
    loop {
        let waiting = client.status("school").await.unwrap().result.waiting_for;
        if waiting.iter().any(|it| it.controller == name) {
            return;
        }
        assert!(began.elapsed() < Duration::from_secs(20), "{waiting:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dropped_advance_is_continued_by_the_same_call() {
    let daemon = Daemon::start().await;
    let client = school(&daemon).await;
    let mut ada = join(&client, "ada", &[1]).await;
    let mut eve = join(&client, "eve", &[2]).await;
    // Dropped while it waits for the other controller.
    let dropped = within(20_000, ada.advance(1, towards(&[1], 0.5), Return::None)).await;
    assert!(dropped.is_none(), "{dropped:?}");
    let (first, second) = tokio::join!(
        ada.advance(1, towards(&[1], 0.5), Return::None),
        eve.advance(1, None, Return::None)
    );
    assert_eq!((first.unwrap().step, second.unwrap().step), (1, 1));
    // Executed meanwhile.
    let dropped = within(20_000, ada.advance(1, None, Return::State)).await;
    assert!(dropped.is_none(), "{dropped:?}");
    waits_for(&client, "eve").await;
    assert_eq!(eve.advance(1, None, Return::None).await.unwrap().step, 2);
    let reply = ada.advance(1, None, Return::State).await.unwrap();
    assert_eq!((reply.step, reply.result.state.unwrap().step), (2, 2));
    assert_eq!(client.status("school").await.unwrap().step, 2);
    // Another one replaces it while the swarm waits.
    let dropped = within(20_000, ada.advance(1, towards(&[1], 0.5), Return::None)).await;
    assert!(dropped.is_none(), "{dropped:?}");
    let (first, second) = tokio::join!(ada.advance(1, towards(&[1], 1.0), Return::State), async {
        waits_for(&client, "eve").await;
        eve.advance(1, None, Return::None).await
    });
    let (first, second) = (first.unwrap(), second.unwrap());
    assert_eq!((first.step, second.step), (3, 3));
    assert_eq!(first.result.state.unwrap().direction[1], 1.0);
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_advance_that_is_dropped_while_its_steps_run_is_continued() {
    let daemon = Daemon::start().await;
    let client = school(&daemon).await;
    let mut ada = join(&client, "ada", &[1]).await;
    let mut steps = 2_000;
    let mut last = 0;
    // Steps that take longer, until the future is dropped before their end.
    loop {
        last += steps;
        match within(20_000, ada.advance(steps, None, Return::None)).await {
            Some(reply) => assert_eq!(reply.unwrap().step, last),
            None => break,
        }
        steps *= 2;
    }
    let long = Duration::from_secs(60);
    let reply = ada.advance_within(steps, None, Return::None, long).await;
    let reply = reply.unwrap();
    assert_eq!((reply.step, reply.result.steps), (last, steps));
    assert_eq!(ada.step(), last);
    let reply = ada.advance(1, None, Return::None).await.unwrap();
    assert_eq!(reply.step, last + 1);
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_advance_that_is_dropped_at_any_moment_is_executed_once() {
    let daemon = Daemon::start().await;
    let client = school(&daemon).await;
    let mut ada = join(&client, "ada", &[1]).await;
    let (mut step, mut dropped) = (0, 0);
    for micros in (0..3000).step_by(25) {
        step += 2;
        // The reply with the state of some is stored without it.
        let return_ = if micros % 2 == 0 {
            Return::State
        } else {
            Return::None
        };
        let reply = match within(micros, ada.advance(2, None, return_)).await {
            Some(reply) => reply,
            None => {
                dropped += 1;
                ada.advance(2, None, return_).await
            }
        };
        let reply = reply.unwrap();
        assert_eq!((reply.step, ada.step()), (step, step), "after {micros} µs");
        assert_eq!(reply.result.state.is_some(), return_ == Return::State);
    }
    assert!(dropped > 0);
    assert_eq!(client.status("school").await.unwrap().step, step);
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancelled_advance_permits_no_steps() {
    let daemon = Daemon::start().await;
    let client = school(&daemon).await;
    let mut ada = join(&client, "ada", &[1]).await;
    let mut eve = join(&client, "eve", &[2]).await;
    let dropped = within(20_000, ada.advance(5, None, Return::None)).await;
    assert!(dropped.is_none(), "{dropped:?}");
    waits_for(&client, "eve").await;
    assert_eq!(ada.cancel().await.unwrap().step, 0);
    assert_eq!(ada.ids(), [1]);
    let (first, second) = tokio::join!(
        async {
            // The swarm waits for it again, and took no step.
            waits_for(&client, "ada").await;
            assert_eq!(client.status("school").await.unwrap().step, 0);
            ada.advance(1, None, Return::None).await
        },
        eve.advance(1, None, Return::None)
    );
    assert_eq!((first.unwrap().step, second.unwrap().step), (1, 1));
    // While the steps run.
    eve.leave().await.unwrap();
    let dropped = within(20_000, ada.advance(1_000_000_000, None, Return::None)).await;
    assert!(dropped.is_none(), "{dropped:?}");
    let state = ada.cancel().await.unwrap();
    assert!(state.step > 1, "the steps that were taken remain");
    let status = client.status("school").await.unwrap();
    assert_eq!((status.step, status.phase), (state.step, Phase::Paused));
    let reply = ada.advance(1, None, Return::None).await.unwrap();
    assert_eq!(reply.step, state.step + 1);
    // Without an advance it returns the state.
    assert_eq!(ada.cancel().await.unwrap().step, state.step + 1);
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn after_a_cancelled_advance_it_steers_the_individuals_that_were_drawn() {
    let daemon = Daemon::start().await;
    let client = school(&daemon).await;
    let mut ada = join_with(&client, "ada", Select::Count(3)).await;
    let drawn = ada.ids().to_vec();
    let _eve = join_with(&client, "eve", Select::Count(1)).await;
    // One that was drawn again may be the same once.
    for steps in 1..=4 {
        let dropped = within(20_000, ada.advance(steps, None, Return::None)).await;
        assert!(dropped.is_none(), "{dropped:?}");
        waits_for(&client, "eve").await;
        ada.cancel().await.unwrap();
        assert_eq!(ada.ids(), drawn);
    }
    // Without one that another client has removed.
    let select = Select::Ids(vec![drawn[0]]);
    client
        .execute("school", &RemoveArgs { select })
        .await
        .unwrap();
    let dropped = within(20_000, ada.advance(9, None, Return::None)).await;
    assert!(dropped.is_none(), "{dropped:?}");
    ada.cancel().await.unwrap();
    assert_eq!(ada.ids(), &drawn[1..]);
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dropped_command_gets_its_reply_by_its_request_id() {
    let daemon = Daemon::start().await;
    let client = school(&daemon).await;
    let mut seqs = Vec::new();
    for micros in (0..3000).step_by(50) {
        let options = CommandOptions {
            request_id: Some(format!("after {micros}")),
            ..CommandOptions::default()
        };
        let args = SetArgs {
            pi3: Some(1.0 + micros as f64 / 1000.0),
            ..SetArgs::default()
        };
        let command = || client.command("school", "set", &args, options.clone());
        let reply = match within(micros, command()).await {
            Some(reply) => reply,
            None => command().await,
        };
        let reply: Reply<SetResult> = reply.unwrap().read().unwrap();
        seqs.push(reply.seq);
    }
    let expected: Vec<u64> = (1..=seqs.len() as u64).collect();
    assert_eq!(seqs, expected, "each was executed once");
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_dropped_join_leaves_no_controller() {
    let daemon = Daemon::start().await;
    let client = school(&daemon).await;
    for micros in (0..4000).step_by(100) {
        let args = JoinArgs {
            controller: format!("c{micros}"),
            select: Some(Select::Ids(vec![1])),
            mode: Mode::Lockstep,
            deadline_secs: 60.0,
            on_timeout: OnTimeout::Hold,
            driving: false,
            again: false,
        };
        drop(within(micros, client.join("school", args)).await);
        // The next one steers the same individual: the daemon has removed this one.
        let began = Instant::now();
        loop {
            let list = client.get("school", "controllers").await.unwrap();
            let list: Reply<ControllerList> = list.read().unwrap();
            if list.result.controllers.is_empty() {
                break;
            }
            assert!(
                began.elapsed() < Duration::from_secs(20),
                "after {micros} µs: {list:?}"
            );
        }
    }
    client.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn advances_go_on_after_a_kill_takes_some_back() {
    let folder = tempfile::tempdir().unwrap();
    let (mut process, endpoint) = Process::start(folder.path(), "tcp/127.0.0.1:0");
    let client = school_at(&endpoint).await;
    let mut ada = join(&client, "ada", &[1]).await;
    let (mut step, mut taken_back) = (0, 0);
    // At least three kills, and one that comes before an advance is durable.
    for kill in 0..20 {
        if kill >= 3 && taken_back > 0 {
            break;
        }
        for _ in 0..20 {
            step += 1;
            let reply = ada
                .advance(1, towards(&[1], 0.1), Return::None)
                .await
                .unwrap();
            assert_eq!(reply.step, step);
        }
        process.kill();
        process = Process::start(folder.path(), &endpoint).0;
        let near = Client::connect(ConnectOptions::to(&*endpoint))
            .await
            .unwrap();
        taken_back += step - near.status("school").await.unwrap().step;
        near.close().await;
    }
    step += 1;
    assert_eq!(ada.advance(1, None, Return::None).await.unwrap().step, step);
    assert!(taken_back > 0, "no kill came before an advance was durable");
    client.close().await;
}
