/* SPDX-License-Identifier: Apache-2.0
 * holds.h: which senders of a lease are held. Pure. */
#ifndef MOTORD_HOLDS_H
#define MOTORD_HOLDS_H

#include "rt.h"

/* Note a command of a sender that the lease's arbiter accepts. */
void holds_note(lease_senders *s, uint32_t sender, bool motion, int64_t now_ns, bool may_move);
bool holds_sender(const lease_senders *s, uint32_t sender);
/* Nothing may move: hold each sender whose request is open, also one that is silent now. */
void holds_stop(lease_senders *s, int64_t now_ns);
/* Hold all senders, also those that come later, since another lease of the owner was held. */
void holds_inherit(lease_senders *s, int64_t since_ns);
/* A person lets all go on. */
void holds_clear(lease_senders *s);
/* The robot was armed: let those go on that have been silent for SOURCE_SILENT_S. */
void holds_arm(lease_senders *s, int64_t now_ns);
/* Write what the state of the lease shows about its senders. */
void holds_show(const lease_senders *s, lease_state *lease);

#endif
