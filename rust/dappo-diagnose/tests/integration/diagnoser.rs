//! Training a diagnoser as a whole: it learns, it does not cheat, resuming is bit-identical, it does not
//! depend on threads, and what it saves reads back.

use std::cell::Cell;
use std::path::{Path, PathBuf};

use dappo_diagnose::train::{DiagnoserOutcome, EpochMetrics, EpochProgress, Observer, train};
use dappo_diagnose::{
    Diagnoser, DiagnoserConfig, Head, Method, PairSource, Schedule, Split, Subject, TrainingFolder, Window,
};
use dappo_learn::Result;
use dappo_sim::DamageSpace;
use dappo_sim::rng::{Purpose, Stream};

const STEPS: usize = 12;
const OBS: usize = 6;

/// Windows made of noise that a rollout's classes share, its twin included, and, if `informative`, of a wave in
/// the observations of the damaged limb.
struct Synthetic {
    subject: Subject,
    rollouts: usize,
    informative: bool,
}

impl PairSource for Synthetic {
    fn rollouts(&self) -> usize {
        self.rollouts
    }

    fn classes(&self) -> usize {
        self.subject.classes()
    }

    fn timesteps(&self) -> usize {
        STEPS
    }

    fn obs_dim(&self) -> usize {
        OBS
    }

    fn action_dim(&self) -> usize {
        1
    }

    fn read(&self, rollout: usize, class: usize, timesteps: usize, window: &mut Window) -> Result<()> {
        let mut common = Stream::new(99, rollout as u64, Purpose::InitialState);
        let shared: Vec<f64> = (0..OBS).map(|_| common.normal()).collect();
        let mut own = Stream::new(rollout as u64, class as u64, Purpose::ActionNoise);
        window.damaged.clear();
        window.twin.clear();
        window.actions.clear();
        for step in 0..timesteps {
            // The last component never varies.
            for (column, shared) in shared.iter().enumerate() {
                let is_constant = column + 1 == OBS;
                let bit = self.subject.codes[class].get(column).copied().unwrap_or(0);
                let wave = if self.informative { f64::from(bit) * (0.8 * step as f64).sin() } else { 0.0 };
                let value = shared + 0.3 * own.normal() + wave;
                window.damaged.push(if is_constant { 1.0 } else { value as f32 });
                window.twin.push(if is_constant { 1.0 } else { *shared as f32 });
            }
            window.actions.push(own.normal() as f32);
        }
        Ok(())
    }
}

/// Two limbs of two damage types: 9 classes, 4 bits.
fn synthetic(rollouts: usize, informative: bool) -> Synthetic {
    let types = vec!["jammed_joint".to_owned(), "missing_toe".to_owned()];
    let subject = Subject::new("biped", &DamageSpace::new(2, types, 2).unwrap());
    Synthetic { subject, rollouts, informative }
}

/// Five limbs of one damage type: healthy, 5 single damages, 10 pairs.
fn five_limbs(rollouts: usize) -> Synthetic {
    let subject = Subject::new("starfish", &DamageSpace::new(5, vec!["cut".to_owned()], 2).unwrap());
    Synthetic { subject, rollouts, informative: true }
}

/// Records its calls, and stops before a given step.
#[derive(Default)]
struct Watch {
    metrics: Vec<EpochMetrics>,
    progress: Vec<EpochProgress>,
    /// It requests the stop in this call.
    stop_at: Option<usize>,
    calls: Cell<usize>,
}

impl Observer for Watch {
    fn progress(&mut self, progress: &EpochProgress) {
        self.progress.push(*progress);
    }

    fn epoch(&mut self, metrics: &EpochMetrics) {
        self.metrics.push(metrics.clone());
    }

    fn should_stop(&self) -> bool {
        self.calls.set(self.calls.get() + 1);
        self.stop_at == Some(self.calls.get())
    }
}

/// A folder that is removed after the test.
struct Temporary(PathBuf);

impl Temporary {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("dappo-diagnoser-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&path);
        Self(path)
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn small() -> DiagnoserConfig {
    DiagnoserConfig {
        timesteps: STEPS,
        embedding: 32,
        lstm: 12,
        hidden: vec![32, 16],
        learning_rate: 5e-3,
        minibatch_size: 32,
        epochs: 12,
        ..DiagnoserConfig::default()
    }
}

fn start(config: &DiagnoserConfig, source: &Synthetic, at: &Path, watch: &mut Watch) -> DiagnoserOutcome {
    let folder = TrainingFolder::create(at, config).unwrap();
    train(config, &source.subject, source, &folder, false, watch).unwrap()
}

fn go_on(
    config: &DiagnoserConfig,
    source: &Synthetic,
    at: &Path,
    watch: &mut Watch,
) -> Result<DiagnoserOutcome> {
    let (folder, _) = TrainingFolder::open(at)?;
    train(config, &source.subject, source, &folder.lock()?, true, watch)
}

/// Bits of the probabilities of the windows of some rollouts.
fn fingerprint(outcome: &DiagnoserOutcome, source: &Synthetic) -> Vec<u32> {
    let (best, diagnoser) = outcome.best.as_ref().unwrap();
    let mut inputs = vec![0.0; STEPS * diagnoser.description().input_dim()];
    let mut bits = vec![best.epoch as u32];
    for class in 0..source.classes() {
        let mut window = Window::default();
        source.read(1, class, STEPS, &mut window).unwrap();
        diagnoser.description().method.write(&window, OBS, 1, &mut inputs).unwrap();
        bits.extend(diagnoser.probabilities(&inputs).unwrap().iter().map(|p| p.to_bits()));
    }
    bits
}

/// The metrics without times.
fn timeless(metrics: &[EpochMetrics]) -> Vec<EpochMetrics> {
    let strip = |m: &EpochMetrics| EpochMetrics { seconds: 0.0, samples_per_second: 0.0, ..m.clone() };
    metrics.iter().map(strip).collect()
}

#[test]
fn classes_that_differ_are_named_on_rollouts_never_seen_with_either_head() {
    let source = synthetic(150, true);
    for head in [Head::Classes, Head::Limbs] {
        let at = Temporary::new(&format!("learns-{head:?}"));
        let config = DiagnoserConfig { head, rollouts: Some(120), ..small() };
        let mut watch = Watch::default();
        let outcome = start(&config, &source, &at.0, &mut watch);
        let split = Split::of(&config, &source);
        let unseen: Vec<usize> =
            (0..150).filter(|r| !split.train.contains(r) && !split.validation.contains(r)).collect();
        assert_eq!(unseen.len(), 30);
        let (best, diagnoser) = outcome.best.unwrap();
        let summary = diagnoser.evaluate(&source, &unseen).unwrap().summary();
        assert!(summary.accuracy > 0.95, "{head:?}: {summary:?} after epoch {best:?}");
        assert!(summary.calibration_error < 0.1, "{head:?}: {summary:?}");
        assert!(best.validation_accuracy > 0.95, "{head:?}: {best:?}");
        assert!(watch.metrics[0].train_loss > 2.0 * best.validation_loss);
    }
}

#[test]
fn labels_without_information_are_guessed_at_chance_on_validation_rollouts() {
    // Windows of a rollout share much; a split that let them leak would be rewarded here.
    let source = synthetic(60, false);
    let at = Temporary::new("chance");
    let config = DiagnoserConfig { method: Method::C, epochs: 8, ..small() };
    let mut watch = Watch::default();
    start(&config, &source, &at.0, &mut watch);
    for metrics in &watch.metrics {
        // Chance is 1/9; four standard deviations of 12 · 9 guesses.
        let distance = (metrics.validation_accuracy - 1.0 / 9.0).abs();
        assert!(distance < 4.0 * (8.0 / 81.0 / 108.0_f64).sqrt(), "{metrics:?}");
        assert!(metrics.validation_loss > 9.0_f64.ln() - 0.1, "{metrics:?}");
    }
}

#[test]
fn the_limb_head_names_pairs_of_damage_that_it_was_never_trained_on() {
    let source = five_limbs(120);
    let at = Temporary::new("unseen");
    // Without dense layers: those memorise pairs and misclassify unseen ones.
    let config = DiagnoserConfig { head: Head::Limbs, held_out: vec![6], hidden: Vec::new(), ..small() };
    let outcome = start(&config, &source, &at.0, &mut Watch::default());
    let (_, diagnoser) = outcome.best.unwrap();
    let report = diagnoser.evaluate(&source, &Split::of(&config, &source).validation).unwrap();
    let summary = report.summary();
    assert!(summary.held_out_accuracy.unwrap() > 0.7, "{summary:?}\n{}", report.confusion_table());
    assert!(report.class_table().lines().nth(7).unwrap().starts_with("6,cut@0+cut@1,true,24,"));
}

#[test]
fn three_epochs_equal_two_epochs_then_resuming_for_another_to_the_bit() {
    let source = synthetic(20, true);
    let (straight, stopped) = (Temporary::new("straight"), Temporary::new("stopped"));
    let config = DiagnoserConfig { epochs: 3, schedule: Schedule::Cosine, ..small() };
    let mut expected = Watch::default();
    let through = start(&config, &source, &straight.0, &mut expected);
    assert_eq!((through.epochs, through.interrupted), (3, false));
    // 16 rollouts of 9 classes in minibatches of about 32 are 5 steps an epoch: stop in the third.
    assert_eq!(expected.progress.iter().map(|p| p.samples).collect::<Vec<_>>(), [144; 3]);
    let mut first = Watch { stop_at: Some(13), ..Watch::default() };
    let outcome = start(&config, &source, &stopped.0, &mut first);
    assert_eq!((outcome.epochs, outcome.interrupted), (2, true));
    let mut second = Watch::default();
    let resumed = go_on(&config, &source, &stopped.0, &mut second).unwrap();
    assert_eq!((resumed.epochs, resumed.interrupted), (3, false));
    let both = [first.metrics, second.metrics].concat();
    assert_eq!(timeless(&both), timeless(&expected.metrics));
    assert_eq!(fingerprint(&resumed, &source), fingerprint(&through, &source));
    let lines = std::fs::read_to_string(stopped.0.join("metrics.jsonl")).unwrap();
    assert_eq!(lines.lines().count(), 3);
}

#[test]
fn resuming_another_training_or_other_data_is_rejected() {
    let source = synthetic(20, true);
    let at = Temporary::new("other");
    let config = DiagnoserConfig { epochs: 1, ..small() };
    start(&config, &source, &at.0, &mut Watch::default());
    let refuse = |config: &DiagnoserConfig, source: &Synthetic| {
        go_on(config, source, &at.0, &mut Watch::default()).unwrap_err().to_string()
    };
    let message = refuse(&DiagnoserConfig { dropout: 0.5, ..config.clone() }, &source);
    assert!(message.contains("dropout is 0.1, expected 0.5"), "{message}");
    let mut other = synthetic(20, true);
    other.subject.robot = "triped".into();
    assert!(refuse(&config, &other).contains("belongs to robot `biped`, expected `triped`"));
    let mut other = synthetic(20, true);
    other.subject.class_names[1] = "renamed".into();
    assert!(refuse(&config, &other).contains("other damage classes"));
    // More epochs are the same training.
    let more =
        go_on(&DiagnoserConfig { epochs: 2, ..config }, &source, &at.0, &mut Watch::default()).unwrap();
    assert_eq!(more.epochs, 2);
}

#[test]
fn a_whole_training_does_not_depend_on_the_number_of_threads() {
    let source = synthetic(30, true);
    let run = |threads: usize| {
        let at = Temporary::new(&format!("threads-{threads}"));
        // Large enough that burn's own products use several threads.
        let config = DiagnoserConfig {
            timesteps: STEPS,
            minibatch_size: 256,
            epochs: 3,
            ..DiagnoserConfig::default()
        };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut watch = Watch::default();
            let outcome = start(&config, &source, &at.0, &mut watch);
            (timeless(&watch.metrics), fingerprint(&outcome, &source))
        })
    };
    let expected = run(1);
    assert_eq!(run(2), expected);
    assert_eq!(run(5), expected);
}

#[test]
fn training_stops_when_patience_is_lost_and_keeps_the_best_epoch() {
    // Nothing can be learned, so the validation loss soon rises.
    let source = synthetic(20, false);
    let at = Temporary::new("patience");
    let config = DiagnoserConfig { epochs: 100, patience: 2, ..small() };
    let mut watch = Watch::default();
    let outcome = start(&config, &source, &at.0, &mut watch);
    let (best, _) = outcome.best.unwrap();
    assert!(outcome.epochs < 100 && !outcome.interrupted);
    assert_eq!(best.epoch + 2, outcome.epochs);
    let lowest = watch.metrics.iter().map(|m| m.validation_loss).fold(f64::INFINITY, f64::min);
    assert_eq!(best.validation_loss, lowest);
    // Resuming a finished training changes nothing.
    let again = go_on(&config, &source, &at.0, &mut Watch::default()).unwrap();
    assert_eq!((again.epochs, again.best.unwrap().0), (outcome.epochs, best));
}

#[test]
fn a_saved_diagnoser_reads_back_and_broken_or_foreign_folders_are_rejected_by_name() {
    let source = synthetic(20, true);
    let at = Temporary::new("model");
    let config = DiagnoserConfig { epochs: 1, method: Method::D, ..small() };
    let outcome = start(&config, &source, &at.0, &mut Watch::default());
    let (_, expected) = outcome.best.as_ref().unwrap();
    let model = at.0.join("model");
    let loaded = Diagnoser::load(&model).unwrap();
    assert_eq!(loaded.description(), expected.description());
    assert_eq!(loaded.description().input_dim(), 2 * OBS + 1);
    let mut window = Window::default();
    source.read(3, 4, STEPS, &mut window).unwrap();
    assert_eq!(loaded.diagnose(&window).unwrap(), expected.diagnose(&window).unwrap());
    let message = loaded.probabilities(&[0.0; 5]).unwrap_err().to_string();
    assert!(message.contains("inputs [N, T, F] have 5 elements, expected a multiple of 156"), "{message}");

    let refuse = || Diagnoser::load(&model).unwrap_err().to_string();
    let header = model.join("diagnoser.toml");
    let text = std::fs::read_to_string(&header).unwrap();
    let change = |from: &str, to: &str| {
        assert!(text.contains(from), "{from} is not in {text}");
        std::fs::write(&header, text.replace(from, to)).unwrap();
    };
    change("diagnoser 2", "diagnoser 9");
    assert!(refuse().contains("its format is `dappo-batch diagnoser 9`, expected `dappo-batch diagnoser 2`"));
    change("lstm = 12", "lstm = 13");
    assert!(refuse().contains("weights.bpk"));
    change("obs_dim = 6", "obs_dim = 7");
    assert!(refuse().contains("means of the standardiser has 13 elements, expected 15"));
    std::fs::write(&header, "format = \"something else\"").unwrap();
    assert!(refuse().contains("`something else`"));
    std::fs::write(&header, &text).unwrap();
    let weights = model.join("weights.bpk");
    let mut bytes = std::fs::read(&weights).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&weights, &bytes).unwrap();
    assert!(refuse().contains("weights.bpk") && refuse().contains("CRC-32"));
    std::fs::remove_file(&weights).unwrap();
    assert!(refuse().contains("weights.bpk"));
    std::fs::remove_file(&header).unwrap();
    assert!(refuse().contains("diagnoser.toml"));
}

#[test]
fn data_that_cannot_serve_the_configuration_is_rejected_before_training() {
    let source = synthetic(20, true);
    let refuse = |config: DiagnoserConfig, source: &Synthetic| {
        let at = Temporary::new("refused");
        let folder = TrainingFolder::create(&at.0, &config).unwrap();
        let outcome = train(&config, &source.subject, source, &folder, false, &mut Watch::default());
        outcome.unwrap_err().to_string()
    };
    let message = refuse(DiagnoserConfig { timesteps: 50, ..small() }, &source);
    assert_eq!(message, "`timesteps` is 50, but the windows of the data have 12");
    let message = refuse(DiagnoserConfig { rollouts: Some(21), ..small() }, &source);
    assert_eq!(message, "`rollouts` is 21, expected 2 to 20, as many as the data has");
    let message = refuse(DiagnoserConfig { held_out: vec![9], ..small() }, &source);
    assert_eq!(message, "`held_out` contains damage class 9; the classes are 0 to 8");
    let message = refuse(DiagnoserConfig { held_out: (0..9).collect(), ..small() }, &source);
    assert!(message.contains("one must remain"), "{message}");
    let mut wrong = synthetic(20, true);
    wrong.subject.codes.pop();
    assert!(refuse(small(), &wrong).contains("9 names and 8 damage codes"));
}
