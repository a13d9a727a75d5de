//! MuJoCo's solver parameters (documentation: Modeling, "Solver parameters").

use dappo_lanes::model::Softness;

/// `mjMINIMP` and `mjMAXIMP`, between which MuJoCo clamps impedances.
const IMPEDANCES: [f64; 2] = [1e-4, 0.9999];
/// Highest power of the sigmoid.
const HIGHEST_POWER: f64 = 16.0;
/// `mjMINVAL`.
const TINY: f64 = 1e-15;

/// The softness that `solref` and `solimp` mean, or why the engine cannot express it.
pub(super) fn softness(solref: [f64; 2], solimp: [f64; 5], timestep: f64) -> Result<Softness, String> {
    let clamp = |impedance: f64| impedance.clamp(IMPEDANCES[0], IMPEDANCES[1]);
    let (least, most, width, midpoint, power) =
        (clamp(solimp[0]), clamp(solimp[1]), solimp[2].max(0.0), clamp(solimp[3]), solimp[4].max(1.0));
    let [first, second] = solref;
    let (stiffness, damping) = if first > 0.0 && second > 0.0 {
        // A time constant and a damping ratio. A shorter time than two steps would be unstable: `refsafe`.
        let time = first.max(2.0 * timestep);
        ((most * time * second).powi(2).max(TINY).recip(), 2.0 / (most * time).max(TINY))
    } else if first <= 0.0 && second <= 0.0 {
        // Stiffness and damping themselves, with the other sign.
        (-first / (most * most).max(TINY), -second / most.max(TINY))
    } else {
        return Err(format!("solref {solref:?} mixes its two formats"));
    };
    if least == most || width <= TINY {
        let mean = f64::midpoint(least, most);
        let (impedance, width, midpoint) = ([mean; 2], 1.0, 0.5);
        return Ok(Softness { stiffness, damping, impedance, width, midpoint, power: 1 });
    }
    if power.fract() != 0.0 || power > HIGHEST_POWER {
        return Err(format!(
            "the power of solimp is {power}; it supports whole numbers up to {HIGHEST_POWER}"
        ));
    }
    let power = power as u8;
    Ok(Softness { stiffness, damping, impedance: [least, most], width, midpoint, power })
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEFAULT: [f64; 5] = [0.9, 0.95, 0.001, 0.5, 2.0];

    fn close(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-12 * b.abs()
    }

    #[test]
    fn mujocos_defaults_follow_its_formulas() {
        let soft = softness([0.02, 1.0], DEFAULT, 0.005).unwrap();
        assert!(close(soft.stiffness, 1.0 / (0.95 * 0.95 * 0.02 * 0.02)));
        assert!(close(soft.damping, 2.0 / (0.95 * 0.02)));
        assert_eq!((soft.impedance, soft.width, soft.midpoint, soft.power), ([0.9, 0.95], 0.001, 0.5, 2));
    }

    #[test]
    fn a_time_constant_is_at_least_two_steps() {
        let (short, safe) = (softness([0.002, 1.0], DEFAULT, 0.01), softness([0.02, 1.0], DEFAULT, 0.01));
        assert_eq!(short.unwrap(), safe.unwrap());
    }

    #[test]
    fn negative_numbers_are_stiffness_and_damping() {
        let soft = softness([-100.0, -3.0], DEFAULT, 0.01).unwrap();
        assert!(close(soft.stiffness, 100.0 / (0.95 * 0.95)) && close(soft.damping, 3.0 / 0.95));
        assert!(softness([0.02, -1.0], DEFAULT, 0.01).unwrap_err().contains("mixes"));
    }

    #[test]
    fn impedances_are_clamped_and_a_flat_one_is_its_mean() {
        let soft = softness([0.02, 1.0], [0.0, 1.0, 0.01, 0.5, 1.0], 0.001).unwrap();
        assert_eq!((soft.impedance, soft.power), ([1e-4, 0.9999], 1));
        let flat = softness([0.02, 1.0], [0.8, 0.9, 0.0, 0.5, 6.0], 0.001).unwrap();
        assert!(close(flat.impedance[0], 0.85) && flat.impedance[0] == flat.impedance[1]);
        assert!(softness([0.02, 1.0], [0.8, 0.9, 0.1, 0.5, 2.5], 0.001).unwrap_err().contains("power"));
        assert_eq!(softness([0.02, 1.0], [0.8, 0.9, 0.1, 0.5, 6.0], 0.001).unwrap().power, 6);
    }
}
