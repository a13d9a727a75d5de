//! Every fault of a robot file at once.
//!
//! serde stops at the first fault, so the file is looked through as a table of values before it becomes a
//! [`Robot`](super::Robot). A file without a fault here can be deserialised.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use toml::{Table, Value};

use super::entries::{Entries, shown};
use super::limits::{LARGEST, check_height};
use super::simplify::{check_overrides, check_simplify};
use super::task_faults::{
    check_actions, check_commands, check_curriculum, check_events, check_observation, check_reward_term,
    check_rewards, check_terminations,
};

/// Physics substeps an env step.
const FRAME_SKIP: RangeInclusive<i64> = 1..=1000;
/// Time limit in steps.
const EPISODE_STEPS: RangeInclusive<i64> = 1..=1_000_000_000;
/// Noise of the start state: positions are m or rad, velocities m/s or rad/s.
const QPOS_NOISE: RangeInclusive<f64> = 0.0..=10.0;
const QVEL_NOISE: RangeInclusive<f64> = 0.0..=100.0;
/// Limbs of a robot, a guard against a mistyped file: each limb multiplies the damage classes.
const MOST_LIMBS: usize = 64;

/// What is wrong with a robot file, a sentence a fault; empty if nothing is.
pub(super) fn faults(file: &Table) -> Vec<String> {
    let mut found = Vec::new();
    let mut top = Entries::new(file, String::new(), &mut found);
    if let Some(name) = top.text("name")
        && !is_file_name(name)
    {
        top.fault(&format!(
            "`name` is {name:?}, expected letters, digits, `-`, `_` and `.`, at most 64, the first one no `.`: run \
             folders are called after it"
        ));
    }
    top.text("mjcf");
    top.text("main_body");
    top.whole("frame_skip", FRAME_SKIP);
    top.whole("max_episode_steps", EPISODE_STEPS);
    // A task has sections of the present or of the earlier form.
    let has = |key: &str| file.contains_key(key);
    let actions = if has("actions") { top.table("actions") } else { None };
    if !has("actions") {
        top.positive("action_scale", LARGEST);
    }
    let limbs = top.list("limbs");
    let damage = top.table("damage");
    let reset = top.table("reset");
    let terminations = top.optional_table("terminations");
    let termination = if has("terminations") || has("actions") { None } else { top.table("termination") };
    let observation = top.table("observation");
    let rewards = top.optional_table("rewards");
    let reward = if has("rewards") { None } else { top.table("reward") };
    let commands = top.optional_table("commands");
    let events = top.optional_table("events");
    let curriculum = top.optional_table("curriculum");
    top.optional_text("task");
    let tasks = top.optional_table("tasks");
    let simplify = top.optional_table("simplify");
    let overrides = top.optional_tables("override");
    let pictures = top.optional_table("pictures");
    top.finish();

    let touches = limbs.map(|limbs| check_limbs(limbs, &mut found));
    if let (Some(damage), Some(limbs)) = (damage, limbs) {
        check_damage(damage, limbs.len(), &mut found);
    }
    if let Some(reset) = reset {
        let mut entries = Entries::new(reset, "[reset]".into(), &mut found);
        entries.optional_text("keyframe");
        entries.number("qpos_noise", QPOS_NOISE);
        entries.number("qvel_noise", QVEL_NOISE);
        entries.finish();
    }
    if let Some(termination) = termination {
        let mut entries = Entries::new(termination, "[termination]".into(), &mut found);
        check_height(&mut entries);
        entries.finish();
    }
    if let Some(terminations) = terminations {
        check_terminations(terminations, &mut found);
    }
    if let Some(actions) = actions {
        check_actions(actions, &mut found);
    }
    if let Some(commands) = commands {
        check_commands(commands, &mut found);
    }
    if let Some(curriculum) = curriculum {
        check_curriculum(curriculum, &mut found);
    }
    if let Some(events) = events {
        check_events(events, &mut found);
    }
    for (name, task) in tasks.into_iter().flatten().filter(|(_, task)| !task.is_table()) {
        found.push(format!("[tasks]: `{name}` is {}, expected a table [tasks.{name}]", shown(task)));
    }
    if let Some(rewards) = rewards {
        check_rewards(rewards, &mut found);
    }
    if let Some(observation) = observation {
        check_observation(observation, touches.unwrap_or(true), &mut found);
    }
    if let Some(reward) = reward {
        check_reward_functions(reward, &mut found);
    }
    if let Some(simplify) = simplify {
        check_simplify(simplify, &mut found);
    }
    if let Some(overrides) = overrides {
        check_overrides(overrides, &mut found);
    }
    if let Some(pictures) = pictures {
        let mut entries = Entries::new(pictures, "[pictures]".into(), &mut found);
        entries.optional_text("camera");
        entries.finish();
    }
    found
}

/// Whether a name can be part of the name of a folder, on every system.
fn is_file_name(name: &str) -> bool {
    let known = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.');
    name.len() <= 64 && name.bytes().all(known) && !name.starts_with('.')
}

/// Checks the limbs; whether each has a touch sensor.
fn check_limbs(limbs: &[Value], found: &mut Vec<String>) -> bool {
    if limbs.is_empty() || limbs.len() > MOST_LIMBS {
        found.push(format!(
            "`limbs` has {} entries, expected 1 to {MOST_LIMBS} tables [[limbs]]",
            limbs.len()
        ));
        return false;
    }
    let (mut touches, mut seen) = (0, BTreeMap::new());
    for (index, limb) in limbs.iter().enumerate() {
        let place = format!("limb {index}");
        let Some(limb) = limb.as_table() else {
            found.push(format!("{place}: expected a table [[limbs]], got {}", shown(limb)));
            continue;
        };
        let mut entries = Entries::new(limb, place, found);
        for key in ["name", "body"] {
            let Some(text) = entries.text(key) else { continue };
            if let Some(other) = seen.insert((key, text), index) {
                entries.fault(&format!("`{key}` is {text:?}, which limb {other} has already"));
            }
        }
        for joint in entries.texts("joints", 1) {
            if let Some(other) = seen.insert(("joints", joint), index) {
                entries.fault(&format!("the joint {joint:?} is listed by limb {other} already"));
            }
        }
        entries.optional_text("toe_geom");
        touches += usize::from(entries.optional_text("touch").is_some());
        entries.optional_text("touch_site");
        entries.optional_text("foot");
        entries.finish();
    }
    if touches != 0 && touches != limbs.len() {
        found.push(format!(
            "{touches} of {} limbs have a `touch` sensor; give it to all or none",
            limbs.len()
        ));
    }
    touches > 0
}

fn check_damage(damage: &Table, limbs: usize, found: &mut Vec<String>) {
    let mut entries = Entries::new(damage, "[damage]".into(), found);
    let types = entries.texts("types", 0);
    if let Some((index, twice)) =
        types.iter().enumerate().find(|(index, name)| types[..*index].contains(name))
    {
        entries.fault(&format!("`types` lists {twice:?} twice, the second time as entry {index}"));
    }
    let most = entries.whole("max_damaged_limbs", 0..=limbs as i64);
    entries.optional_whole("max_damages_per_limb", 1..=types.len().max(1) as i64);
    entries.optional_texts("modules", 1);
    if most.is_some_and(|most| most > 0) && damage.contains_key("types") && types.is_empty() {
        entries.fault("`max_damaged_limbs` is above 0, but `types` is empty");
    }
    // Any other entry is the table of a damage type, whose parameters belong to Python.
    for (key, value) in damage {
        if !matches!(key.as_str(), "types" | "max_damaged_limbs" | "max_damages_per_limb" | "modules")
            && !value.is_table()
        {
            entries.fault(&format!(
                "`{key}` is {}; expected `types`, `max_damaged_limbs`, `max_damages_per_limb`, `modules` or a table [damage.TYPE] with the parameters of a \
                 damage type",
                shown(value)
            ));
        }
    }
}

fn check_reward_functions(reward: &Table, found: &mut Vec<String>) {
    let mut entries = Entries::new(reward, "[reward]".into(), found);
    let names: Vec<&str> = reward.keys().map(String::as_str).filter(|key| *key != "default").collect();
    if let Some(default) = entries.text("default")
        && !names.contains(&default)
    {
        entries.fault(&format!(
            "`default` is {default:?}, which is not one of the rewards ({})",
            names.join(", ")
        ));
    }
    for name in names {
        let Some(function) = reward[name].as_table() else {
            found.push(format!(
                "[reward]: `{name}` is {}, expected a table [reward.{name}]",
                shown(&reward[name])
            ));
            continue;
        };
        let place = format!("[reward.{name}]");
        let mut entries = Entries::new(function, place.clone(), found);
        let terms = entries.terms();
        entries.finish();
        for (index, term) in terms {
            check_reward_term(&mut Entries::new(term, format!("{place} term {index}"), found));
        }
    }
}
