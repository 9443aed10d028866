//! The unit without links, as fast as the model runs.

use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread;

use geu_model::fault::acting::FaultEngine;
use geu_model::{Configuration, Truth};

use crate::event_source::EventSource;
use crate::recorder::{RecordError, Recorder, UnitEvent};

/// Samples handed over at a time: enough that handing over costs nothing, few enough that they stay in the cache.
const BATCH: u64 = 128;
/// Batches that may wait to be written.
const QUEUE: usize = 4;

/// Runs `samples` of the unit on `truth` into `recorder`, with the commands its configuration recorded; how its
/// faults and expectations stand then.
///
/// The model runs on a thread of its own; this one writes what it tells, in its order. `progress` is told how many half
/// seconds are written, now and then, and says whether to go on: where not, the run ends with those.
///
/// # Errors
/// A file that cannot be written.
pub fn simulate(
    configuration: &Configuration,
    truth: &Truth,
    samples: u64,
    recorder: &mut Recorder,
    mut progress: impl FnMut(u64) -> bool,
) -> Result<FaultEngine, RecordError> {
    thread::scope(|scope| {
        let (sender, batches) = sync_channel(QUEUE);
        let model = scope.spawn(move || run(configuration, truth, samples, &sender));
        let mut written = 0;
        // Who leaves the loop drops the receiver, which ends the model.
        for batch in batches {
            for event in batch {
                recorder.event(&event)?;
            }
            written = samples.min(written + BATCH);
            if !progress(written) {
                break;
            }
        }
        Ok(model.join().expect("the model does not panic"))
    })
}

/// Runs the unit and sends all that happens, until the end or until the receiver is gone.
fn run(configuration: &Configuration, truth: &Truth, samples: u64, sender: &SyncSender<Vec<UnitEvent>>) -> FaultEngine {
    let mut source = EventSource::new(configuration, truth);
    let mut batch = Vec::new();
    source.take_happened(&mut batch);
    // The sample that runs at the end never ends, but its commands are answered.
    for index in 0..=samples {
        source.repeat_recorded(&mut batch);
        if index < samples {
            let (ended, traces) = source.end_traced();
            batch.push(UnitEvent::Sample(ended, traces, source.unit.injected().cloned()));
            source.take_happened(&mut batch);
        }
        let is_full = (index + 1).is_multiple_of(BATCH) || index == samples;
        if is_full && sender.send(std::mem::take(&mut batch)).is_err() {
            break;
        }
    }
    source.unit.faults().clone()
}
