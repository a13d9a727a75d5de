//! What holds for every input: damage classes, class weights and robot files, valid or not.

use dappo_sim::curriculum::{ClassDistribution, ClassMix, Stage, stage_at};
use dappo_sim::{DamageSpace, Robot};
use proptest::collection::vec;
use proptest::prelude::*;

use crate::cases::cases;

const TRIPOD: &str = include_str!("../../../../tests/python/robots/tripod.toml");

fn spaces() -> impl Strategy<Value = DamageSpace> {
    (1_usize..6, 1_usize..4, 1_usize..4).prop_map(|(limbs, types, most)| {
        let names = ["jammed_joint", "missing_toe", "weak_motor"];
        DamageSpace::new(limbs, names[..types].iter().map(ToString::to_string).collect(), most.min(limbs))
            .unwrap()
    })
}

/// Pieces of damage specs, and what does not belong there.
fn words() -> impl Strategy<Value = String> {
    let piece = prop_oneof![
        Just("healthy".to_owned()),
        Just("jammed_joint".to_owned()),
        Just("missing_toe".to_owned()),
        Just("@".to_owned()),
        Just("+".to_owned()),
        any::<u64>().prop_map(|number| number.to_string()),
        (0_u8..9).prop_map(|number| number.to_string()),
        any::<char>().prop_map(String::from),
    ];
    vec(piece, 0..7).prop_map(|pieces| pieces.concat())
}

/// Numbers of all kinds, the odd ones often.
fn numbers() -> impl Strategy<Value = f64> {
    prop_oneof![
        any::<f64>(),
        Just(0.0),
        Just(-0.0),
        Just(f64::NAN),
        Just(f64::INFINITY),
        Just(f64::MAX),
        Just(f64::MIN_POSITIVE),
        0.0..1.0,
    ]
}

/// A robot file of which a piece was replaced.
fn robot_files() -> impl Strategy<Value = String> {
    let other = prop_oneof![
        words(),
        numbers().prop_map(|number| number.to_string()),
        Just(String::new()),
        Just("[[limbs]]\n".to_owned()),
        Just("9223372036854775807".to_owned()),
    ];
    (0..TRIPOD.len(), 0_usize..40, other).prop_map(|(start, length, other)| {
        let end = (start + length).min(TRIPOD.len());
        format!("{}{other}{}", &TRIPOD[..start], &TRIPOD[end..])
    })
}

proptest! {
    #![proptest_config(cases(400))]

    #[test]
    fn names_of_damage_classes_read_back(space in spaces()) {
        for (index, class) in space.classes().iter().enumerate() {
            prop_assert_eq!(space.parse(&class.name).unwrap(), index);
        }
    }

    #[test]
    fn a_spec_is_a_class_or_an_error_that_holds_it(space in spaces(), spec in words()) {
        match space.parse(&spec) {
            Ok(class) => prop_assert!(class < space.classes().len()),
            Err(error) => prop_assert!(!error.to_string().is_empty()),
        }
    }

    #[test]
    fn classes_are_drawn_that_have_a_weight_and_no_others(weights in vec(numbers(), 0..6), u in 0.0..1.0_f64) {
        let is_usable = weights.iter().all(|weight| weight.is_finite() && *weight >= 0.0);
        if let Ok(classes) = ClassDistribution::from_weights(&weights) {
            prop_assert!(is_usable);
            prop_assert!(weights[classes.at(u)] > 0.0);
            prop_assert!(weights[classes.at(1.0)] > 0.0);
        } else {
            let sum: f64 = weights.iter().sum();
            prop_assert!(!is_usable || sum == 0.0 || sum.is_infinite());
        }
    }

    #[test]
    fn stages_follow_one_another(budgets in vec(0.01..100.0_f64, 1..6), first in 0.0..1.0_f64, step in 0.0..1.0_f64) {
        let mix = uniform();
        let stages: Vec<Stage> =
            budgets.iter().map(|&budget| Stage { name: "stage".into(), budget, mix: mix.clone() }).collect();
        let (one, two) = (stage_at(&stages, first), stage_at(&stages, first + step));
        prop_assert!(one <= two && two < stages.len());
        prop_assert_eq!(stage_at(&stages, 0.0), 0);
        prop_assert_eq!(stage_at(&stages, 1.0), stages.len() - 1);
    }

    #[test]
    fn a_robot_file_is_a_robot_or_an_error(text in robot_files()) {
        if let Err(error) = Robot::from_toml(&text) {
            prop_assert!(!error.to_string().is_empty());
        }
    }
}

fn uniform() -> ClassMix {
    ClassMix::Named("uniform".into())
}
