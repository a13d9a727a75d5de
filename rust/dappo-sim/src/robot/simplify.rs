//! Faults of `[simplify]` and `[[override]]`. What depends on the MJCF, such as names of joints, is checked in Python,
//! which applies both.

use toml::{Table, Value};

use super::entries::{Entries, shown};
use super::limits::LARGEST;

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

#[cfg(test)]
mod tests {
    use super::super::Robot;
    use super::super::tests::GOOD;

    #[test]
    fn simplifications_and_overrides_without_faults_are_accepted() {
        let text = format!(
            "{GOOD}
[simplify]
self_collision = false
floor_contacts = [\"toe\"]
cone = \"pyramidal\"
timestep = 0.004
integrator = \"implicitfast\"
impratio = 1
condim = 3
[[override]]
joints = \".*\"
armature = 0.01
damping = 1
frictionloss = 0
stiffness = 0.0
range = [-1, 1]
[[override]]
actuators = \"a1\"
kp = 20
kd = 0.5
force_range = [-20, 20.0]
ctrl_range = [-1, 1]
control = \"position\"
gear = -1
[[override]]
geoms = \"toe\"
friction = 0.8
condim = 1
solref = [0.02, 1]
solimp = [0.9, 0.95, 0.001]
margin = 0.001
"
        );
        assert_eq!(Robot::faults(&text), Vec::<String>::new());
        let robot = Robot::from_toml(&text).unwrap();
        assert_eq!((robot.simplify.unwrap().len(), robot.overrides.len()), (7, 3));
    }

    #[test]
    fn every_fault_of_simplifications_and_overrides_is_named_with_what_is_expected() {
        for (text, fault) in [
            ("simplify = 3", "`simplify` is 3, expected a table [simplify]"),
            (
                "[simplify]\nself_collison = false",
                "[simplify]: unknown entries self_collison; expected self_collision",
            ),
            ("[simplify]\nself_collision = 0", "`self_collision` is 0, expected true or false"),
            ("[simplify]\nfloor_contacts = []", "`floor_contacts` is empty"),
            ("[simplify]\nfloor_contacts = \"FR\"", "`floor_contacts` is \"FR\", expected a list"),
            ("[simplify]\nfloor_contacts = [\"FR\", \"FR\"]", "`floor_contacts` lists \"FR\" twice"),
            (
                "[simplify]\nself_collision = true\nfloor_contacts = [\"FR\"]",
                "leaves no contact within the robot",
            ),
            (
                "[simplify]\ncone = \"square\"",
                "`cone` is \"square\", expected one of \"pyramidal\", \"elliptic\"",
            ),
            (
                "[simplify]\nintegrator = \"implicit\"",
                "`integrator` is \"implicit\", expected one of \"rk4\"",
            ),
            ("[simplify]\ntimestep = 0", "`timestep` is 0, expected a number above 0 and at most 10"),
            ("[simplify]\nimpratio = nan", "`impratio` is nan, expected a number above 0"),
            ("[simplify]\ncondim = 2", "`condim` is 2, expected one of 1, 3, 4, 6"),
            ("override = 3", "`override` is 3, expected tables [[override]]"),
            ("override = [3]", "[[override]] 0: expected a table [[override]], got 3"),
            ("[[override]]\nkp = 1", "[[override]] 0: it has none of `joints`, `actuators` and `geoms`"),
            ("[[override]]\njoints = \"a\"\ngeoms = \"b\"", "it has joints and geoms of `joints`"),
            ("[[override]]\njoints = 1\ndamping = 1", "`joints` is 1, expected a text"),
            ("[[override]]\njoints = \"a\"", "it changes nothing; expected one of armature, damping"),
            ("[[override]]\njoints = \"a\"\nkp = 1", "unknown entries kp; expected joints, armature"),
            ("[[override]]\njoints = \"a\"\ndamping = -1", "`damping` is -1, expected a number from 0"),
            ("[[override]]\njoints = \"a\"\nrange = [1, 0]", "`range` is a list, expected [low, high]"),
            ("[[override]]\njoints = \"a\"\nrange = [0, inf]", "`range` is a list, expected [low, high]"),
            ("[[override]]\nactuators = \"a\"\nkp = 0", "`kp` is 0, expected a number above 0"),
            (
                "[[override]]\nactuators = \"a\"\ncontrol = \"speed\"",
                "expected one of \"position\", \"torque\"",
            ),
            (
                "[[override]]\nactuators = \"a\"\ncontrol = \"torque\"\nkd = 1",
                "`kd` is a gain of position control, but `control` is \"torque\"",
            ),
            ("[[override]]\ngeoms = \"a\"\nfriction = [1, 1, 1, 1]", "a list of up to 3 numbers"),
            ("[[override]]\ngeoms = \"a\"\nsolimp = []", "`solimp` is a list, expected a number, or a list"),
        ] {
            let (top, tables) = if text.starts_with('[') { ("", text) } else { (text, "") };
            let faults = Robot::faults(&format!("{top}\n{GOOD}\n{tables}\n"));
            assert_eq!(faults.len(), 1, "{text} gave {faults:?}");
            assert!(faults[0].contains(fault), "{text} gave {faults:?}");
        }
    }
}
