/* SPDX-License-Identifier: Apache-2.0
 * api_clock.h: the clock of every stamp, and the rule when a stamp is fresh. cffi reads it, too. */

int64_t clock_now_ns(void); /* CLOCK_MONOTONIC */
/* Whether a stamp is not older than timeout_ns and no more than 10 ms in the future: 1 or 0. All
 * lines and the core use this rule. */
int stamp_is_fresh(int64_t now_ns, int64_t stamp_ns, int64_t timeout_ns);
/* Return when a suspend of the computer was noticed last; 0: never. Each call checks anew. */
int64_t clock_resumed_ns(void);
/* Whether a stamp is fresh now and not from before a suspend. */
int clock_stamp_is_fresh(int64_t stamp_ns, int64_t timeout_ns);
