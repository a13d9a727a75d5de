//! One folder with everything that a robot needs to adapt, for programs in any language and for a [`Controller`]; or
//! with a policy alone.
//!
//! | file | holds |
//! |---|---|
//! | `export.json` | the [`ExportHeader`], which lists all others with their SHA-256 |
//! | `policy.*`, `diagnoser.*`, `expert.*` | networks, as ONNX from raw inputs on, and as safetensors |
//! | `robot.xml`, `robot.toml` | the healthy robot as MJCF, and its other properties |
//! | `robot-*` | meshes, textures and the like that the MJCF needs |
//! | `config.toml` | the configuration of the policy's run |
//!
//! [`Controller`]: crate::controller::Controller

mod header;
mod networks;
mod onnx;
mod run;
mod tensors;

use std::collections::BTreeMap;
use std::path::Path;

use dappo_learn::{
    config::{Config, Layers},
    error::{FileKind, Result},
    files::{
        Files, io,
        sealed::{Manifest, SealedFolder, UnsealedFolder, check_replaceable, sha256},
        write_new,
    },
    robot_files::RobotFiles,
};
use dappo_nn::Policy;
use dappo_sim::Robot;
use dappo_sim::task::Task;

use crate::controller::{ControllerConfig, Skills};

pub(crate) use header::last_name;
pub use header::{
    ActuatorHeader, ClassHeader, DiagnoserHeader, DiagnoserSource, ExportHeader, FileHeader, JointHeader,
    PolicyHeader, RunSource, Sources, TwinHeader,
};
pub use run::ExportedRun;
use tensors::{Reader, Tensors};

const CONFIG: &str = "config.toml";
const ROBOT: &str = "robot.toml";
const MJCF: &str = "robot.xml";

/// A robot as it is simulated.
pub struct Body<'a> {
    /// Its robot file.
    pub robot: &'a Robot,
    /// Its files, `robot.toml` and `robot.xml` among them, with numbers as they were written: MuJoCo rounds them when
    /// it writes a model down itself.
    pub files: &'a RobotFiles,
    /// Observation and control of the compiled robot.
    pub task: &'a Task,
    /// Integrator, as MuJoCo names it.
    pub integrator: &'a str,
    /// Version of MuJoCo.
    pub mujoco: &'a str,
}

/// The contents of a folder.
pub struct Contents<'a> {
    /// The policy.
    pub policy: &'a Policy,
    /// The damage classes.
    pub classes: Vec<ClassHeader>,
    /// The learned parts of a controller and its settings; nothing for a policy alone.
    pub controller: Option<(&'a Skills, &'a ControllerConfig)>,
    /// The robot.
    pub body: Body<'a>,
    /// The configuration of the policy's run.
    pub config: &'a Config,
    /// Where the parts come from; without a run of the expert, the policy itself is the expert.
    pub sources: Sources,
}

impl Contents<'_> {
    /// Writes the folder next to `out`, to be committed once it has been checked.
    pub fn stage(&self, out: &Path) -> Result<Staged> {
        let mut header = self.header()?;
        let mut files: BTreeMap<String, Vec<u8>> = self.body.files.iter().cloned().collect();
        files.insert(CONFIG.to_owned(), self.run_config()?.into_bytes());
        let mut add = |tensors: &Tensors, names: [&String; 2], onnx: Vec<u8>| -> Result<()> {
            files.insert(names[0].clone(), onnx);
            files.insert(names[1].clone(), tensors.to_bytes(&out.join(names[1]))?);
            Ok(())
        };
        let skills = self.controller.map(|(skills, _)| skills);
        let expert = header.expert.as_ref().zip(skills.map(|skills| &skills.expert));
        for (part, policy) in [Some((&header.policy, self.policy)), expert].into_iter().flatten() {
            let tensors = networks::policy_tensors(policy)?;
            add(&tensors, [&part.onnx, &part.tensors], onnx::policy(part, &tensors)?)?;
        }
        if let Some((part, skills)) = header.diagnoser.as_ref().zip(skills) {
            let tensors = networks::diagnoser_tensors(&skills.diagnoser)?;
            add(&tensors, [&part.onnx, &part.tensors], onnx::diagnoser(&header, part, &tensors)?)?;
        }
        let folder = UnsealedFolder::create(out)?;
        for (name, bytes) in &files {
            write_new(&folder.path().join(name), bytes)?;
        }
        let sums = folder.list(sha256)?.into_iter();
        header.files = sums.map(|(name, (bytes, sha256))| (name, FileHeader { bytes, sha256 })).collect();
        folder.seal(&header)?;
        Ok(Staged(folder))
    }

    fn header(&self) -> Result<ExportHeader> {
        let Self { policy, classes, controller, body, sources, .. } = self;
        let skills = controller.map(|(skills, _)| skills);
        let twin = skills.and_then(|skills| skills.diagnoser.description().twin);
        Ok(ExportHeader {
            format: ExportHeader::FORMAT.into(),
            version: env!("CARGO_PKG_VERSION").into(),
            robot: body.robot.name.clone(),
            control_period: body.task.dt(),
            obs_dim: policy.obs_dim(),
            action_dim: body.task.layout().nu,
            observation: body.task.entries(),
            joints: JointHeader::of(&body.task.layout().anatomy),
            classes: classes.clone(),
            controller: controller.map(|(_, config)| config.clone()),
            policy: networks::policy_header("policy", policy),
            expert: sources
                .expert
                .as_ref()
                .zip(skills)
                .map(|(_, skills)| networks::policy_header("expert", &skills.expert)),
            diagnoser: skills.map(|skills| networks::diagnoser_header(&skills.diagnoser)),
            twin: TwinHeader {
                mjcf: MJCF.into(),
                mujoco: body.mujoco.to_owned(),
                integrator: body.integrator.to_owned(),
                frame_skip: body.task.frame_skip,
                action_scale: body.task.action_scale(),
                actuators: body
                    .task
                    .controls()
                    .filter(|_| body.task.action_scale().is_none())
                    .map(ActuatorHeader::from)
                    .collect(),
                observation: body.robot.observation.policy.terms.clone(),
                touch_sensors: body.robot.limbs.iter().filter_map(|limb| limb.touch.clone()).collect(),
                forward_velocity: body.robot.main_body.clone(),
                action: twin.map(|twin| twin.action),
                resync: twin.map(|twin| twin.resync),
                residual_scale: skills
                    .filter(|_| twin.is_some())
                    .map(|skills| skills.compared(body.task))
                    .transpose()?,
            },
            sources: sources.clone(),
            files: BTreeMap::new(),
        })
    }

    /// The configuration of the run, whose robot is the one in the folder.
    fn run_config(&self) -> Result<String> {
        Config { robot: ROBOT.into(), ..self.config.clone() }.to_toml()
    }
}

/// An export that is written but not yet where it belongs. It vanishes unless it is [committed](Staged::commit).
pub struct Staged(UnsealedFolder<ExportHeader>);

impl Staged {
    /// Fails unless `out` is new, empty, or an export that may be replaced.
    pub fn check(out: &Path) -> Result<()> {
        check_replaceable::<ExportHeader>(out)
    }

    /// Path of the export until it is committed.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.0.path()
    }

    /// Moves the export to its place, replacing an earlier one.
    pub fn commit(self) -> Result<()> {
        self.0.commit()
    }
}

/// An export folder whose files are those that were written.
pub struct Export {
    sealed: SealedFolder<ExportHeader>,
}

impl Export {
    /// Opens a folder and verifies its files.
    pub fn open(folder: &Path) -> Result<Self> {
        let sealed = SealedFolder::<ExportHeader>::open(&std::path::absolute(folder).map_err(io(folder))?)?;
        if let Some(controller) = &sealed.manifest().controller {
            controller.check().map_err(|error| FileKind::Export.unusable(sealed.folder(), error))?;
        }
        Ok(Self { sealed })
    }

    /// Its path.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.sealed.folder()
    }

    /// What it is.
    #[must_use]
    pub fn header(&self) -> &ExportHeader {
        self.sealed.manifest()
    }

    /// A file as it was written.
    fn read(&self, name: &str) -> Result<Vec<u8>> {
        self.sealed.read(name, self.header().files.get(name).map_or(0, |file| file.bytes))
    }

    /// The configuration with which the robot and its twins are compiled.
    pub fn config(&self) -> Result<Config> {
        let path = self.sealed.path(CONFIG);
        let text =
            String::from_utf8(self.read(CONFIG)?).map_err(|error| FileKind::Export.unusable(&path, error))?;
        let mut layers = Layers::default();
        layers.add_toml(&text, &path.display().to_string())?;
        Ok(Config { robot_file: Some(self.sealed.path(ROBOT)), ..layers.resolve()? })
    }

    /// The files of the robot.
    pub fn robot_files(&self) -> Result<RobotFiles> {
        let names = self.header().files.keys().filter(|name| name.starts_with("robot"));
        names.map(|name| Ok((name.clone(), self.read(name)?))).collect()
    }

    /// The policy.
    pub fn policy(&self) -> Result<Policy> {
        self.read_policy(&self.header().policy)
    }

    /// The learned parts of a controller, and its settings.
    pub fn controller(&self) -> Result<(Skills, ControllerConfig)> {
        let ExportHeader { diagnoser: Some(diagnoser), controller: Some(config), .. } = self.header() else {
            let message = "it holds a policy alone, and a controller needs a diagnoser, too; export again with \
                           --diagnoser, or take the policy by itself with Policy.from_export";
            return Err(FileKind::Export.unusable(self.folder(), message));
        };
        let policy = self.policy()?;
        let expert = self
            .header()
            .expert
            .as_ref()
            .map_or_else(|| Ok(policy.clone()), |part| self.read_policy(part))?;
        let name = &diagnoser.tensors;
        let (path, bytes) = (self.sealed.path(name), self.read(name)?);
        let diagnoser = networks::read_diagnoser(self.header(), diagnoser, &Reader::new(&path, &bytes)?)?;
        let baselines: Option<Vec<f64>> = self.header().classes.iter().map(|class| class.baseline).collect();
        if baselines.is_none() && diagnoser.description().twin.is_some() {
            let message = "a damage class has no `baseline`; export again";
            return Err(FileKind::Export.unusable(self.folder(), message));
        }
        Ok((Skills { policy, expert, diagnoser, baselines }, config.clone()))
    }

    fn read_policy(&self, part: &PolicyHeader) -> Result<Policy> {
        let (path, bytes) = (self.sealed.path(&part.tensors), self.read(&part.tensors)?);
        networks::read_policy(part, self.header().obs_dim, &Reader::new(&path, &bytes)?)
    }
}
