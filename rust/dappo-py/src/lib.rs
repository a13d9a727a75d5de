//! `dappo_batch._core`: thin Python classes over the crates below, and the command line.

mod anatomy;
mod arguments;
mod class_table;
mod cli;
mod command;
mod controller;
mod damage;
mod diagnoser;
mod errors;
mod factory;
mod files;
mod keywords;
mod kinds;
mod model_reader;
mod outside_policy;
mod policy;
mod pool;
mod python_terms;
mod robot;
mod run_robot;
mod symmetry;
mod testing;
mod variants;
mod vector_env;
mod warp;

use pyo3::prelude::*;

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    errors::register(module)?;
    module.add_class::<damage::PyDamageClass>()?;
    module.add_class::<damage::PyDamageSpace>()?;
    module.add_class::<vector_env::PyVectorEnv>()?;
    module.add_class::<vector_env::PyEnvState>()?;
    module.add_class::<controller::PyController>()?;
    module.add_class::<policy::PyPolicy>()?;
    module.add_class::<diagnoser::PyDiagnoser>()?;
    module.add_class::<testing::exported_networks::PyExportedNetworks>()?;
    module.add_class::<testing::lane_worlds::PyLaneWorlds>()?;
    module.add_function(wrap_pyfunction!(robot::robot_body_events, module)?)?;
    module.add_function(wrap_pyfunction!(robot::robot_faults, module)?)?;
    module.add_function(wrap_pyfunction!(robot::robot_task, module)?)?;
    module.add_function(wrap_pyfunction!(robot::robot_with_task, module)?)?;
    module.add_function(wrap_pyfunction!(class_table::gpu_device, module)?)?;
    module.add_function(wrap_pyfunction!(class_table::lane_support, module)?)?;
    module.add_function(wrap_pyfunction!(testing::rollout::collect_rollout, module)?)?;
    module.add_function(wrap_pyfunction!(files::read_file, module)?)?;
    module.add_function(wrap_pyfunction!(files::write_file, module)?)?;
    module.add_function(wrap_pyfunction!(cli::run_cli, module)?)?;
    module.add_function(wrap_pyfunction!(command::run_command, module)?)?;
    module.add_function(wrap_pyfunction!(keywords::check_settings, module)?)?;
    Ok(())
}
