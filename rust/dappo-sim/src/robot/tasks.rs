//! Tasks in files of their own, so that several robots can have the same.

use toml::{Table, Value};

use super::nesting::is_deeper_than;
use super::{DEEPEST, LARGEST_FILE};
use crate::error::SimError;

/// Entries of a robot file that describe the robot.
const ROBOT: [&str; 8] = ["name", "mjcf", "main_body", "limbs", "damage", "simplify", "override", "pictures"];
/// Entries of a task file.
const TASK: [&str; 10] = [
    "frame_skip",
    "max_episode_steps",
    "commands",
    "actions",
    "reset",
    "observation",
    "rewards",
    "terminations",
    "events",
    "curriculum",
];

/// The text of a robot file with a task in the place of its own: the robot's entries, and those of the task, among
/// which those of the robot's table `[tasks.NAME]` take precedence.
pub fn with_task(robot: &str, task: &str, name: &str) -> Result<String, SimError> {
    let parse = |text: &str, what: &str| {
        if text.len() > LARGEST_FILE || is_deeper_than(text, DEEPEST) {
            return Err(SimError::Config(format!(
                "{what} has more than {LARGEST_FILE} bytes, or its tables and lists are nested more than {DEEPEST} deep"
            )));
        }
        text.parse::<Table>().map_err(|error| SimError::Config(format!("{what} is not valid TOML: {error}")))
    };
    let mut robot = parse(robot, "the robot file")?;
    let mut merged = parse(task, &format!("the task `{name}`"))?;
    let unknown: Vec<&str> = merged.keys().map(String::as_str).filter(|key| !TASK.contains(key)).collect();
    if !unknown.is_empty() {
        return Err(SimError::Config(format!(
            "the task `{name}` has unknown entries {}; expected {}",
            unknown.join(", "),
            TASK.join(", ")
        )));
    }
    if let Some(Value::Table(mut tasks)) = robot.remove("tasks")
        && let Some(Value::Table(own)) = tasks.remove(name)
    {
        merge(&mut merged, own);
    }
    merged.extend(robot.into_iter().filter(|(key, _)| ROBOT.contains(&key.as_str())));
    toml::to_string(&merged).map_err(|error| SimError::Config(format!("the task `{name}`: {error}")))
}

/// Puts the entries of a table over those of another, table by table.
fn merge(table: &mut Table, over: Table) {
    for (key, value) in over {
        match (table.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(value)) => merge(inner, value),
            (_, value) => {
                table.insert(key, value);
            }
        }
    }
}
