//! Paired episodes over a backend without physics: which damage code every agent is given, and what is kept.

use dappo_learn::envs::EnvFactory;
use dappo_learn::walk::{Agent, Encoding, Kept, KnownClasses, Trial, Walks, onset_at};
use dappo_sim::DamageSpace;
use dappo_sim::vector_env::{DamageCourse, StepRange};

use crate::counter::{CODE, ROW};
use crate::evaluation::{Factory, Recorder, STEPS, code_of, config, read};

/// Two episodes of each of these classes, with damage at step 1.
fn trial(classes: &[usize], kept: Kept) -> Trial {
    let course = DamageCourse { onset: StepRange { first: 1, last: 1 }, ..DamageCourse::default() };
    Trial { classes: classes.to_vec(), episodes: 2, course, seed: 0, kept }
}

fn run(trial: &Trial, mut agent: Agent<'_>) -> Walks {
    trial.run(&mut agent, &config(2, true), &Factory::new(2), &|| false).unwrap().unwrap()
}

/// The codes shown in the first and in the last step, `[N]` each; the active damage is the robot's own.
fn first_and_last(seen: &[Vec<f32>], classes: &[usize]) -> [Vec<Vec<f32>>; 2] {
    assert_eq!(seen.len(), STEPS);
    [(0, false), (STEPS - 1, true)].map(|(step, is_damaged)| {
        let rows = seen[step].chunks_exact(ROW + CODE).map(read).enumerate();
        rows.map(|(env, row)| {
            assert_eq!(row.class, if is_damaged { classes[env / 2] } else { 0 });
            row.code.to_vec()
        })
        .collect()
    })
}

#[test]
fn the_true_code_follows_the_damage_and_that_of_a_healthy_robot_does_not() {
    let (classes, known) = ([0, 5], KnownClasses::of(Factory::new(2).space()));
    let healthy = vec![vec![0.0; CODE]; 4];
    for (encoding, last) in [
        (Encoding::True, vec![code_of(0), code_of(0), code_of(5), code_of(5)]),
        (Encoding::Zero, healthy.clone()),
    ] {
        let policy = Recorder::new(|_, _| [1.0, 0.0]);
        run(&trial(&classes, Kept::Sums), Agent::Encoded(&policy, &known, encoding));
        assert_eq!(first_and_last(&policy.seen.into_inner(), &classes), [healthy.clone(), last]);
    }
}

#[test]
fn damage_that_the_policy_was_not_trained_with_has_the_code_of_none() {
    let types = vec!["weak_motor".into(), "missing_toe".into()];
    let trained_with = DamageSpace::new(4, types, 1).unwrap();
    let known = KnownClasses::new(&trained_with, Factory::new(2).space());
    // The robots' classes 1 and 2 are jammed_joint@0 and missing_toe@0, of which the policy has the second.
    let (classes, policy) = ([1, 2], Recorder::new(|_, _| [1.0, 0.0]));
    run(&trial(&classes, Kept::Sums), Agent::Encoded(&policy, &known, Encoding::True));
    let [_, last] = first_and_last(&policy.seen.into_inner(), &classes);
    let missing_toe: Vec<f32> = (0..CODE).map(|entry| if entry == 1 { 1.0 } else { 0.0 }).collect();
    assert_eq!(last, [vec![0.0; CODE], vec![0.0; CODE], missing_toe.clone(), missing_toe]);
}

#[test]
fn a_given_class_is_that_of_its_row_whatever_the_damage() {
    let (classes, given) = ([5, 0, 5], [0, 7, 5]);
    let known = KnownClasses::of(Factory::new(2).space());
    let policy = Recorder::new(|_, _| [1.0, 0.0]);
    run(&trial(&classes, Kept::Sums), Agent::Given(&policy, &known, &given));
    let codes: Vec<Vec<f32>> = given.iter().flat_map(|&class| [code_of(class), code_of(class)]).collect();
    assert_eq!(first_and_last(&policy.seen.into_inner(), &classes), [codes.clone(), codes]);
}

#[test]
fn a_policy_that_is_unaware_of_damage_has_no_code() {
    let policy = Recorder { width: ROW, ..Recorder::new(|_, _| [1.0, 0.0]) };
    run(&trial(&[0, 5], Kept::Sums), Agent::Unaware(&policy));
    assert!(policy.seen.into_inner().iter().all(|obs| obs.len() == 4 * ROW));
}

#[test]
fn every_agent_walks_the_same_episodes_and_no_more_of_them_is_kept_than_asked_for() {
    for (kept, velocities, positions) in
        [(Kept::Sums, 0, 0), (Kept::Velocities, STEPS, 0), (Kept::Positions, STEPS, STEPS + 1)]
    {
        // Robots of class 5 fall in the second step, the first one with damage.
        let act = |class, step| if (class, step) == (5, 2) { [0.5, 1.0] } else { [0.5, 0.0] };
        let policy = Recorder { width: ROW, ..Recorder::new(act) };
        let walks = run(&trial(&[0, 5], kept), Agent::Unaware(&policy));
        assert_eq!(walks.decision_seconds.len(), STEPS);
        for (index, episode) in walks.episodes.iter().enumerate() {
            assert_eq!((episode.class, episode.onset), ([0, 0, 5, 5][index], 1));
            assert_eq!((episode.steps, episode.fell, episode.diverged), (STEPS, episode.class == 5, false));
            // The counter's velocities are ten times the number of the step.
            assert_eq!((episode.forward_reward, episode.episode_return), (60.0, 1.5));
            assert_eq!(episode.velocities, [10.0, 20.0, 30.0][..velocities]);
            let of_this = if index == 0 { positions } else { 0 };
            let expected: Vec<f64> = (0..of_this).flat_map(|step| [0.0, step as f64, 0.0]).collect();
            assert_eq!(episode.positions, expected);
        }
    }
}

#[test]
fn damage_after_the_end_of_the_episodes_is_rejected() {
    let at = |step| onset_at(step, &config(2, true), &Factory::new(2));
    assert_eq!(at(2).unwrap().onset, StepRange { first: 2, last: 2 });
    let message = at(STEPS).unwrap_err().to_string();
    assert_eq!(message, "the damage is to strike at step 3, but an episode has 3 steps");
}
