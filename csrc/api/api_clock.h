/* SPDX-License-Identifier: Apache-2.0
 * api_clock.h: the clock of every stamp, and when a stamp is fresh. Read by cffi too. */

int64_t clock_now_ns(void); /* CLOCK_MONOTONIC */
/* 1: not older than timeout_ns, and no more than 10 ms in the future; 0. The one rule of all lines
 * and of the core. */
int stamp_is_fresh(int64_t now_ns, int64_t stamp_ns, int64_t timeout_ns);
/* When a suspend of the computer was noticed last; 0: there was none. Each call checks anew. */
int64_t clock_resumed_ns(void);
/* now, and not from before a suspend */
int clock_stamp_is_fresh(int64_t stamp_ns, int64_t timeout_ns);
