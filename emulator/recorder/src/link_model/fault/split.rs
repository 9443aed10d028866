//! Inserts a gap into the sample: after this byte of a frame, on CAN after this message.

use geu_model::fault::catalogue::link_fault::Split;

use super::{Context, LinkBehaviour, Schedule, Transmission, WireData, ns};

impl LinkBehaviour for Split {
    fn schedule(&self, schedule: &mut Schedule, context: &Context) {
        let (place, gap_ns) = (self.byte as usize, ns(self.gap_s));
        match context.encoding.is_can() {
            true => {
                schedule.transmissions.iter_mut().skip(place).for_each(|it| it.after_ns += gap_ns);
            }
            false => {
                // A gap also delays the later parts of a frame that was split before.
                let mut later_ns = 0;
                let parts = schedule.transmissions.drain(..).flat_map(|transmission| {
                    let whole = Transmission { after_ns: transmission.after_ns + later_ns, ..transmission };
                    let more_fragments = whole.more_fragments;
                    let parts = split(whole, place, gap_ns);
                    later_ns = match more_fragments {
                        true => later_ns + gap_ns * i64::from(parts.len() > 1),
                        false => 0,
                    };
                    parts
                });
                schedule.transmissions = parts.collect();
            }
        }
    }
}

/// The parts before and after the gap; one part if the data has at most `place` bytes.
fn split(whole: Transmission, place: usize, gap_ns: i64) -> Vec<Transmission> {
    let bytes = whole.content.bytes();
    if bytes.len() <= place {
        return vec![whole];
    }
    let part = |bytes: &[u8], after_ns, more_fragments| Transmission {
        frame: whole.frame,
        after_ns,
        content: WireData::Bytes(bytes.to_vec()),
        more_fragments,
    };
    let (head, tail) = bytes.split_at(place);
    vec![part(head, whole.after_ns, true), part(tail, whole.after_ns + gap_ns, whole.more_fragments)]
}
