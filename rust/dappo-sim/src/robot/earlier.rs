//! Robot files in the form of earlier versions, whose task has fewer sections.

use toml::{Table, Value};

/// Name of the reward function that `[rewards]` describes.
pub(super) const TASK_REWARD: &str = "task";

/// A robot file without faults, in the present form.
///
/// | earlier | present |
/// |---|---|
/// | `action_scale = 1.0` | `actions = { type = "control", scale = 1.0 }` |
/// | `[termination] height` | `[terminations] height` |
/// | `[observation] terms` | `[observation.policy] terms` |
///
/// A single reward, `[rewards.NAME]`, becomes one of several, `[reward.task] terms`, so that both are read alike.
pub(super) fn brought_up_to_date(mut file: Table) -> Table {
    if let Some(scale) = file.remove("action_scale") {
        let entries = [("type".to_owned(), Value::from("control")), ("scale".to_owned(), scale)];
        file.insert("actions".into(), Value::Table(entries.into_iter().collect()));
    }
    if let Some(termination) = file.remove("termination") {
        file.insert("terminations".into(), termination);
    }
    if let Some(Value::Table(observation)) = file.get_mut("observation")
        && let Some(terms) = observation.remove("terms")
    {
        observation.insert("policy".into(), table("terms", terms));
    }
    if let Some(Value::Table(rewards)) = file.remove("rewards") {
        let terms = rewards.into_iter().filter_map(|(name, term)| named(name, term)).collect();
        let mut reward = Table::new();
        reward.insert("default".into(), TASK_REWARD.into());
        reward.insert(TASK_REWARD.into(), table("terms", Value::Array(terms)));
        file.insert("reward".into(), Value::Table(reward));
    }
    if let Some(Value::Table(functions)) = file.get_mut("reward") {
        let lists =
            functions.iter_mut().filter_map(|(_, function)| function.get_mut("terms")?.as_array_mut());
        for term in lists.flatten().filter_map(Value::as_table_mut) {
            if let Some(name) = term.get("term").filter(|_| !term.contains_key("name")).cloned() {
                term.insert("name".into(), name);
            }
        }
    }
    file
}

/// A term of `[rewards]`: its name is that of its kind unless it has an entry `term`.
fn named(name: String, term: Value) -> Option<Value> {
    let Value::Table(mut term) = term else { return None };
    term.entry("term").or_insert_with(|| name.clone().into());
    term.insert("name".into(), name.into());
    Some(Value::Table(term))
}

fn table(key: &str, value: Value) -> Value {
    Value::Table([(key.to_owned(), value)].into_iter().collect())
}
