//! Faults of `[simplify]` and `[[override]]`. What depends on the MJCF, such as names of joints, is checked in Python,
//! which applies both.

use toml::{Table, Value};

use super::entries::{Entries, shown};
use super::faults::LARGEST;

const CONDIM: [i64; 4] = [1, 3, 4, 6];
/// Longest physics step, s: that of an env step.
const LONGEST_STEP: f64 = 10.0;
const SELECTORS: [&str; 3] = ["joints", "actuators", "geoms"];

/// Checks the table `[simplify]`.
pub(super) fn check_simplify(simplify: &Table, found: &mut Vec<String>) {
    let mut entries = Entries::new(simplify, "[simplify]".into(), found);
    let self_collision = entries.optional_flag("self_collision");
    let names = entries.optional_texts("floor_contacts", 1);
    if let Some(twice) =
        names.iter().enumerate().find(|(index, name)| names[..*index].contains(name)).map(|(_, name)| name)
    {
        entries.fault(&format!("`floor_contacts` lists {twice:?} twice"));
    }
    if self_collision == Some(true) && !names.is_empty() {
        entries.fault(
            "`self_collision` is true, but `floor_contacts` leaves no contact within the robot; remove one of them",
        );
    }
    entries.optional_choice("cone", &["pyramidal", "elliptic"]);
    entries.optional_choice("integrator", &["rk4", "euler", "implicitfast"]);
    entries.optional_positive("timestep", LONGEST_STEP);
    entries.optional_positive("impratio", LARGEST);
    entries.optional_whole_of("condim", &CONDIM);
    entries.finish();
}

/// Checks the tables `[[override]]`.
pub(super) fn check_overrides(overrides: &[Value], found: &mut Vec<String>) {
    for (index, item) in overrides.iter().enumerate() {
        let place = format!("[[override]] {index}");
        match item.as_table() {
            Some(item) => check_override(item, Entries::new(item, place, found)),
            None => found.push(format!("{place}: expected a table [[override]], got {}", shown(item))),
        }
    }
}

fn check_override(item: &Table, mut entries: Entries) {
    let selectors: Vec<&'static str> =
        SELECTORS.iter().copied().filter(|key| item.contains_key(*key)).collect();
    let [selector] = selectors[..] else {
        let got = if selectors.is_empty() { "none".into() } else { selectors.join(" and ") };
        return entries.fault(&format!(
            "it has {got} of `joints`, `actuators` and `geoms`; expected exactly one, a regular expression for names"
        ));
    };
    entries.text(selector);
    match selector {
        "joints" => {
            for key in ["armature", "damping", "frictionloss", "stiffness"] {
                entries.optional_number(key, 0.0..=LARGEST);
            }
            entries.optional_range("range");
        }
        "actuators" => check_actuators(item, &mut entries),
        _ => {
            entries.optional_leading("friction", 3, 0.0..=LARGEST);
            entries.optional_whole_of("condim", &CONDIM);
            entries.optional_leading("solref", 2, -LARGEST..=LARGEST);
            entries.optional_leading("solimp", 5, 0.0..=LARGEST);
            entries.optional_number("margin", 0.0..=LARGEST);
        }
    }
    entries.finish();
    if item.len() == 1 {
        entries.fault(&format!("it changes nothing; expected one of {}", entries.known_after(selector)));
    }
}

fn check_actuators(item: &Table, entries: &mut Entries) {
    let control = entries.optional_choice("control", &["position", "torque"]);
    entries.optional_positive("kp", LARGEST);
    entries.optional_number("kd", 0.0..=LARGEST);
    entries.optional_range("force_range");
    entries.optional_range("ctrl_range");
    entries.optional_number("gear", -LARGEST..=LARGEST);
    if control == Some("torque") {
        for key in ["kp", "kd"].into_iter().filter(|key| item.contains_key(*key)) {
            entries.fault(&format!(
                "`{key}` is a gain of position control, but `control` is \"torque\"; remove one of them"
            ));
        }
    }
}
