//! Faults of the sections of a robot file that describe its task.

use std::ops::RangeInclusive;

use toml::{Table, Value};

use super::entries::{Entries, shown};
use super::event_faults;
use super::limits::{LARGEST, LONGEST, check_height};

/// Most steps of a delay or a history.
const MOST_STEPS: i64 = 1000;

/// Most compiled variants of a robot.
const MOST_VARIANTS: i64 = 1000;
/// Events that change bodies, with the entry for their range, and its bounds: factors, and m.
const BODIES: [(&str, &str, RangeInclusive<f64>); 3] = [
    ("link_length", "scale", 0.1..=10.0),
    ("mass", "scale", 1e-3..=1e3),
    ("center_of_mass", "offset", -100.0..=100.0),
];

/// What a term expects besides what all terms have.
#[derive(Clone, Copy)]
enum Parameter {
    Positive(&'static str),
    OptionalWhole(&'static str),
    /// A whole number above 0.
    Size(&'static str),
    /// `module:function`.
    Function(&'static str),
}
use Parameter::{Function, OptionalWhole, Positive, Size};

/// Terms of an observation, and their parameters.
const OBSERVATIONS: [(&str, &[Parameter]); 19] = [
    ("qpos", &[OptionalWhole("skip")]),
    ("qvel", &[]),
    ("cfrc_ext", &[]),
    ("touch", &[]),
    ("base_height", &[]),
    ("base_lin_vel", &[]),
    ("base_ang_vel", &[]),
    ("projected_gravity", &[]),
    ("command", &[]),
    ("joint_pos", &[]),
    ("joint_vel", &[]),
    ("last_action", &[]),
    ("clock", &[Positive("period")]),
    ("foot_contact", &[]),
    ("foot_vel", &[]),
    ("foot_height", &[]),
    ("foot_air_time", &[]),
    ("events", &[]),
    ("python", &[Function("function"), Size("size")]),
];

/// Terms of a reward, and their parameters.
const REWARDS: [(&str, &[Parameter]); 26] = [
    ("forward_velocity", &[]),
    ("survive", &[]),
    ("termination", &[]),
    ("limb_contacts", &[]),
    ("ctrl_squared", &[]),
    ("contact_forces_squared", &[Positive("clip")]),
    ("link_loads_squared", &[Positive("clip")]),
    ("track_lin_vel", &[Positive("std")]),
    ("track_ang_vel", &[Positive("std")]),
    ("upright", &[Positive("std")]),
    ("tilt_squared", &[]),
    ("lin_vel_z_squared", &[]),
    ("ang_vel_xy_squared", &[]),
    ("base_height_squared", &[Positive("target")]),
    ("action_rate_squared", &[]),
    ("torque_squared", &[]),
    ("power", &[]),
    ("joint_limits", &[Positive("soft")]),
    ("pose_squared", &[]),
    ("pose", &[Positive("std")]),
    ("stand_still", &[]),
    ("feet_air_time", &[Positive("threshold")]),
    ("feet_slip", &[]),
    ("feet_clearance", &[Positive("target")]),
    ("landing", &[]),
    ("python", &[Function("function")]),
];

fn check_parameters(entries: &mut Entries, parameters: &[Parameter]) {
    for parameter in parameters {
        match *parameter {
            Positive(key) => {
                entries.positive(key, LARGEST);
            }
            OptionalWhole(key) => {
                entries.optional_whole(key, 0..=1_000_000);
            }
            Size(key) => {
                entries.whole(key, 1..=1_000_000);
            }
            Function(key) => {
                if let Some(name) = entries.text(key) {
                    check_function(entries, key, name);
                }
            }
        }
    }
}

/// Checks the name of a Python function.
fn check_function(entries: &mut Entries, key: &str, name: &str) {
    let is_name = |name: &str| {
        let is_part = |part: &str| {
            !part.starts_with(|first: char| first.is_ascii_digit())
                && !part.is_empty()
                && part.chars().all(|letter| letter.is_alphanumeric() || letter == '_')
        };
        name.split('.').all(is_part)
    };
    if !name.split_once(':').is_some_and(|(module, function)| is_name(module) && is_name(function)) {
        entries.fault(&format!("`{key}` is {name:?}, expected \"module:function\""));
    }
}

/// The parameters of a term, or a fault that lists all terms.
fn parameters(
    entries: &mut Entries,
    name: &str,
    terms: &[(&str, &'static [Parameter])],
) -> Option<&'static [Parameter]> {
    let found = terms.iter().find(|(term, _)| *term == name).map(|(_, parameters)| *parameters);
    if found.is_none() {
        let names: Vec<&str> = terms.iter().map(|(term, _)| *term).collect();
        entries.fault(&format!("`term` is {name:?}, expected one of {}", names.join(", ")));
    }
    found
}

/// Checks the section `[observation]`, in its present or its earlier form.
pub(super) fn check_observation(observation: &Table, has_touch: bool, found: &mut Vec<String>) {
    if observation.contains_key("terms") {
        return check_group(observation, "[observation]", has_touch, found);
    }
    let mut entries = Entries::new(observation, "[observation]".into(), found);
    let (policy, critic) = (entries.table("policy"), entries.optional_table("critic"));
    entries.finish();
    for (group, place) in [(policy, "[observation.policy]"), (critic, "[observation.critic]")] {
        if let Some(group) = group {
            check_group(group, place, has_touch, found);
        }
    }
}

fn check_group(group: &Table, place: &str, has_touch: bool, found: &mut Vec<String>) {
    let mut entries = Entries::new(group, place.into(), found);
    let terms = entries.terms();
    entries.finish();
    for (index, term) in terms {
        let mut entries = Entries::new(term, format!("{place} term {index}"), found);
        let Some(name) = entries.text("term") else { continue };
        if name == "touch" && !has_touch {
            entries.fault("the term `touch` needs a `touch` sensor on every limb");
        }
        let Some(parameters) = parameters(&mut entries, name, &OBSERVATIONS) else { continue };
        check_parameters(&mut entries, parameters);
        if name == "python" {
            entries.finish();
            continue;
        }
        if name == "cfrc_ext" {
            entries.positive("clip", LARGEST);
        } else {
            entries.optional_positive("clip", LARGEST);
        }
        entries.optional_number("noise", 0.0..=LARGEST);
        entries.optional_number("scale", -LARGEST..=LARGEST);
        entries.optional_whole("delay", 0..=MOST_STEPS);
        entries.optional_whole("history", 1..=MOST_STEPS);
        entries.finish();
    }
}

/// Checks a term of `[reward.FUNCTION]`.
pub(super) fn check_reward_term(entries: &mut Entries) {
    if let Some(name) = entries.text("term") {
        check_measure(entries, name);
    }
}

/// Checks the section `[rewards]`.
pub(super) fn check_rewards(rewards: &Table, found: &mut Vec<String>) {
    if rewards.is_empty() {
        found.push("[rewards]: it is empty, expected tables [rewards.NAME]".into());
    }
    for (key, value) in rewards {
        let place = format!("[rewards.{key}]");
        let Some(term) = value.as_table() else {
            found.push(format!("{place}: expected a table, got {}", shown(value)));
            continue;
        };
        let mut entries = Entries::new(term, place, found);
        let name = entries.optional_text("term").unwrap_or(key);
        check_measure(&mut entries, name);
    }
}

fn check_measure(entries: &mut Entries, name: &str) {
    let Some(parameters) = parameters(entries, name, &REWARDS) else { return };
    check_parameters(entries, parameters);
    entries.number("weight", -LARGEST..=LARGEST);
    entries.finish();
}

/// Checks the section `[commands]`.
pub(super) fn check_commands(commands: &Table, found: &mut Vec<String>) {
    let mut entries = Entries::new(commands, "[commands]".into(), found);
    let velocity = entries.optional_table("velocity");
    entries.finish();
    let Some(velocity) = velocity else { return };
    let mut entries = Entries::new(velocity, "[commands.velocity]".into(), found);
    for key in ["lin_vel_x", "lin_vel_y", "ang_vel_z"] {
        entries.span(key, -LARGEST..=LARGEST);
    }
    entries.optional_number("standing", 0.0..=1.0);
    entries.span("resample_every", 1e-3..=LONGEST);
    entries.finish();
}

/// Checks the section `[curriculum]`.
pub(super) fn check_curriculum(curriculum: &Table, found: &mut Vec<String>) {
    let mut entries = Entries::new(curriculum, "[curriculum]".into(), found);
    let commands = entries.optional_table("commands");
    entries.finish();
    if let Some(commands) = commands {
        let mut entries = Entries::new(commands, "[curriculum.commands]".into(), found);
        entries.number("start", 0.0..=1.0);
        entries.whole("steps", 1..=1_000_000_000);
        entries.finish();
    }
}

/// Checks the section `[actions]`.
pub(super) fn check_actions(actions: &Table, found: &mut Vec<String>) {
    let mut entries = Entries::new(actions, "[actions]".into(), found);
    entries.choice("type", &["control", "joint_position"]);
    let by_pattern = actions.get("scale").and_then(Value::as_table);
    if by_pattern.is_some() {
        entries.table("scale");
    } else {
        entries.positive("scale", LARGEST);
    }
    entries.finish();
    for (pattern, scale) in by_pattern.into_iter().flatten() {
        let number = super::entries::number(scale).filter(|number| *number > 0.0 && *number <= LARGEST);
        if number.is_none() {
            found
                .push(format!("[actions] scale: {pattern:?} is {}, expected a number above 0", shown(scale)));
        }
        if let Err(why) = super::pattern(pattern) {
            found.push(format!("[actions] scale: {why}"));
        }
    }
}

/// Checks the section `[terminations]`; `height` is checked elsewhere.
pub(super) fn check_terminations(terminations: &Table, found: &mut Vec<String>) {
    let mut entries = Entries::new(terminations, "[terminations]".into(), found);
    if terminations.contains_key("height") {
        check_height(&mut entries);
    }
    let (tilt, contact) = (entries.optional_table("tilt"), entries.optional_table("contact"));
    let python = entries.optional_table("python");
    entries.finish();
    if let Some(python) = python {
        let mut entries = Entries::new(python, "[terminations.python]".into(), found);
        for name in entries.texts("functions", 1) {
            check_function(&mut entries, "functions", name);
        }
        entries.finish();
    }
    if let Some(tilt) = tilt {
        let mut entries = Entries::new(tilt, "[terminations.tilt]".into(), found);
        entries.positive("angle", std::f64::consts::PI);
        entries.finish();
    }
    if let Some(contact) = contact {
        let mut entries = Entries::new(contact, "[terminations.contact]".into(), found);
        entries.texts("bodies", 1);
        entries.optional_positive("force", LARGEST);
        entries.finish();
    }
}

/// Checks the section `[events]`.
pub(super) fn check_events(events: &Table, found: &mut Vec<String>) {
    let mut entries = Entries::new(events, "[events]".into(), found);
    let scaled = ["friction", "motor_strength", "kp", "kd", "joint_damping", "joint_armature"];
    let scaled = scaled.map(|key| (key, entries.optional_table(key)));
    let bias = entries.optional_table("encoder_bias");
    let delay = entries.optional_table("action_delay");
    let gravity = entries.optional_table("gravity");
    let push = entries.optional_table("push");
    let encoder_fault = entries.optional_table("encoder_fault");
    let imu_fault = entries.optional_table("imu_fault");
    let dropout = entries.optional_table("action_dropout");
    let bodies = BODIES.map(|(key, change, range)| (key, change, range, entries.optional_one_or_more(key)));
    let variants = entries.optional_whole("variants", 1..=MOST_VARIANTS);
    if variants.is_some() && bodies.iter().all(|(.., tables)| tables.is_empty()) {
        entries.fault(
            "`variants` needs link_length, mass or center_of_mass, of which it is the number of samples",
        );
    }
    entries.finish();
    for (key, change, range, tables) in bodies {
        for table in tables {
            let mut entries = Entries::new(table, format!("[events.{key}]"), found);
            if let Some(bodies) = entries.text("bodies")
                && let Err(why) = super::pattern(bodies)
            {
                entries.fault(&format!("`bodies`: {why}"));
            }
            entries.span(change, range.clone());
            entries.finish();
        }
    }
    let mut each = |key: &str, table: Option<&Table>, check: &dyn Fn(&mut Entries)| {
        if let Some(table) = table {
            let mut entries = Entries::new(table, format!("[events.{key}]"), found);
            check(&mut entries);
            entries.finish();
        }
    };
    for (key, table) in scaled {
        each(key, table, &|entries| entries.span("scale", 1e-3..=1e3));
    }
    each("encoder_bias", bias, &|entries| entries.span("offset", -10.0..=10.0));
    each("action_delay", delay, &|entries| entries.whole_span("steps", 0..=MOST_STEPS));
    each("gravity", gravity, &|entries| entries.span("angle", 0.0..=std::f64::consts::PI));
    each("push", push, &|entries| {
        entries.span("every", 1e-3..=LONGEST);
        entries.number("lin_vel", 0.0..=1e3);
        entries.optional_number("ang_vel", 0.0..=1e3);
    });
    event_faults::check_dropout(dropout, found);
    event_faults::check_encoder(encoder_fault, found);
    event_faults::check_imu(imu_fault, found);
}
