//! Reads the parts of a compiled robot that terms of a task refer to, which `model/anatomy.py` finds.

use dappo_sim::task::{ActuatorParts, Anatomy, Foot, FootHinge, FootLink, JointParts};
use pyo3::prelude::*;

/// The parts of the robot of a Python `ClassTable`.
pub fn read(table: &Bound<'_, PyAny>) -> PyResult<Anatomy> {
    let found = table.py().import("dappo_batch.model.anatomy")?.call_method1("find_anatomy", (table,))?;
    let actuators = found.getattr("actuators")?;
    let feet = found.getattr("feet")?;
    Ok(Anatomy {
        start: found.getattr("start")?.extract()?,
        start_ctrl: found.getattr("start_ctrl")?.extract()?,
        actuators: actuators.try_iter()?.map(|item| actuator(&item?)).collect::<PyResult<_>>()?,
        bodies: found.getattr("bodies")?.extract()?,
        feet: feet
            .try_iter()?
            .map(|class| class?.try_iter()?.map(|item| foot(&item?)).collect())
            .collect::<PyResult<_>>()?,
    })
}

fn actuator(item: &Bound<'_, PyAny>) -> PyResult<ActuatorParts> {
    let joint = item.getattr("joint")?;
    let joint = if joint.is_none() {
        None
    } else {
        Some(JointParts {
            name: joint.getattr("name")?.extract()?,
            qpos: joint.getattr("qpos")?.extract()?,
            dof: joint.getattr("dof")?.extract()?,
            range: joint.getattr("range")?.extract()?,
        })
    };
    Ok(ActuatorParts {
        name: item.getattr("name")?.extract()?,
        joint,
        is_position: item.getattr("is_position")?.extract()?,
    })
}

fn foot(item: &Bound<'_, PyAny>) -> PyResult<Foot> {
    let links = item.getattr("links")?;
    Ok(Foot {
        body: item.getattr("body")?.extract()?,
        links: links.try_iter()?.map(|link| foot_link(&link?)).collect::<PyResult<_>>()?,
        offset: item.getattr("offset")?.extract()?,
    })
}

fn foot_link(item: &Bound<'_, PyAny>) -> PyResult<FootLink> {
    let hinge = item.getattr("hinge")?;
    let hinge = if hinge.is_none() {
        None
    } else {
        Some(FootHinge {
            axis: hinge.getattr("axis")?.extract()?,
            anchor: hinge.getattr("anchor")?.extract()?,
            qpos: hinge.getattr("qpos")?.extract()?,
            dof: hinge.getattr("dof")?.extract()?,
            reference: hinge.getattr("reference")?.extract()?,
        })
    };
    Ok(FootLink {
        position: item.getattr("position")?.extract()?,
        orientation: item.getattr("orientation")?.extract()?,
        hinge,
    })
}
