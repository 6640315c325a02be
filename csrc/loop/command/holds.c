/* SPDX-License-Identifier: Apache-2.0
 * holds.c: which senders of a lease are held. A zero ends the request and the hold of its sender
 * alone. A sender that comes while another one is held is held, too: it may be the same program on
 * a new connection. Where senders have no names, the zero may be of one and the next motion of
 * another: there a zero counts when no motion has come for SOURCE_SILENT_S, as long as a lease can
 * live. */
#include "holds.h"

static const int64_t SILENT_NS = SOURCE_SILENT_S * INT64_C(1000000000);

static void hold(sender_state *sender, int64_t since_ns)
{
    sender->held_ns = sender->held_ns != 0 ? sender->held_ns : since_ns;
}

static void end(sender_state *sender)
{
    sender->open = 0;
    sender->held_ns = 0;
}

/* Hold a sender that is new if another one is held. */
static void join(lease_senders *s, sender_state *sender)
{
    for (uint32_t i = 0; i < SENDERS_MAX && sender->taken_ns == 0; i++) {
        hold(sender, s->sender[i].held_ns);
    }
}

/* Whether a command ends the request before it. */
static bool ends(const lease_senders *s, uint32_t number, bool motion, int64_t now_ns)
{
    const sender_state *sender = &s->sender[number];
    if (number != SENDER_UNNAMED) {
        return !motion;
    }
    return (!motion || sender->zero != 0) && now_ns - sender->motion_ns >= SILENT_NS;
}

void holds_note(lease_senders *s, uint32_t number, bool motion, int64_t now_ns, bool may_move)
{
    sender_state *sender = &s->sender[number];
    join(s, sender);
    if (ends(s, number, motion, now_ns)) {
        end(sender);
    }
    if (motion) {
        sender->open = 1;
        sender->motion_ns = now_ns;
    }
    if (motion && !may_move) {
        hold(sender, now_ns);
    }
    sender->zero = !motion;
    sender->taken_ns = now_ns;
}

bool holds_sender(const lease_senders *s, uint32_t sender)
{
    return s->sender[sender].held_ns != 0;
}

void holds_stop(lease_senders *s, int64_t now_ns)
{
    for (uint32_t i = 0; i < SENDERS_MAX; i++) {
        if (s->sender[i].open != 0) {
            hold(&s->sender[i], now_ns);
        }
    }
}

void holds_inherit(lease_senders *s, int64_t since_ns)
{
    for (uint32_t i = 0; i < SENDERS_MAX; i++) {
        sender_state *sender = &s->sender[i];
        hold(sender, since_ns);
        sender->motion_ns = sender->motion_ns > since_ns ? sender->motion_ns : since_ns;
    }
}

void holds_clear(lease_senders *s)
{
    for (uint32_t i = 0; i < SENDERS_MAX; i++) {
        s->sender[i].held_ns = 0;
    }
}

void holds_arm(lease_senders *s, int64_t now_ns)
{
    for (uint32_t i = 0; i < SENDERS_MAX; i++) {
        sender_state *sender = &s->sender[i];
        int64_t newest_ns = sender->taken_ns != 0 ? sender->taken_ns : sender->held_ns;
        sender->held_ns = now_ns - newest_ns >= SILENT_NS ? 0 : sender->held_ns;
    }
}

void holds_show(const lease_senders *s, lease_state *lease)
{
    lease->held = holds_sender(s, s->newest);
    lease->held_ns = lease->open = lease->senders_held = 0;
    for (uint32_t i = 0; i < SENDERS_MAX; i++) {
        const sender_state *sender = &s->sender[i];
        lease->open |= sender->open;
        if (sender->held_ns != 0 && (sender->taken_ns != 0 || i == s->newest)) {
            lease->senders_held++;
            bool first = lease->held_ns == 0 || sender->held_ns < lease->held_ns;
            lease->held_ns = first ? sender->held_ns : lease->held_ns;
        }
    }
}
