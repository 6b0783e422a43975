//! A controller in lock-step, and how it resumes after errors.

use std::time::{Duration, Instant};

use jostle_client::{Client, ConnectOptions, Controller, Error};
use jostle_proto::verbs::{
    CreateArgs, JoinArgs, LeaveArgs, Mode, OnTimeout, RemoveArgs, ResetArgs, Return, Select,
    SetPoints,
};
use jostle_proto::{ErrorCode, Spec};

use crate::daemon::Daemon;

async fn join(client: &Client, name: &str, ids: &[u32]) -> Controller {
    let args = JoinArgs {
        controller: name.into(),
        select: Some(Select::Ids(ids.to_vec())),
        mode: Mode::Lockstep,
        deadline_secs: 60.0,
        on_timeout: OnTimeout::Hold,
        driving: true,
        again: false,
    };
    client.join("school", args).await.unwrap().0
}

async fn school(daemon: &Daemon) -> Client {
    let client = Client::connect(ConnectOptions::to(daemon.endpoint()));
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
