/* SPDX-License-Identifier: Apache-2.0
 * drive_state.c: the rules of all media: when a drive may move, and when it has to stop. Pure: time
 * is an argument. */
#include "drive_state.h"

/* ----------------------------------------------------------------------------- stopping */
void drive_take_back(drive_state *drive, uint32_t why, uint32_t mode)
{
    drive->mode = mode;
    drive->fault_reasons |= why;
    drive->enabled = 2;
}

bool drive_is_changed(drive_state *drive)
{
    bool changed = drive->fault_reasons != drive->reported_reasons;
    drive->reported_reasons = drive->fault_reasons;
    return changed;
}

drive_stop drive_quick_stop(drive_state *drive, uint32_t why, int64_t now_ns)
{
    drive_take_back(drive, why, DRIVE_READY);
    drive->stopping = true;
    drive->off_by_ns = now_ns + DRIVE_STOPPING_NS;
    return STOP_QUICK;
}

drive_stop drive_power_off(drive_state *drive)
{
    drive->stopping = false;
    return STOP_POWER_OFF;
}

drive_stop drive_end_stopping(drive_state *drive, bool at_rest, int64_t now_ns)
{
    bool over =
        drive->stopping && drive->stop == STOP_NOTHING && (at_rest || now_ns >= drive->off_by_ns);
    return over ? drive_power_off(drive) : STOP_NOTHING;
}

drive_stop drive_lost_setup(drive_state *drive)
{
    drive_take_back(drive, DRIVE_FAULT_LOST_SETUP, DRIVE_OFF);
    drive->epoch++; /* it was without power: its counter may have begun again */
    return drive_power_off(drive);
}

void drive_unresponsive(drive_state *drive)
{
    drive_take_back(drive, DRIVE_FAULT_UNRESPONSIVE, DRIVE_UNRESPONSIVE);
    drive->stopping = drive->back = drive->off_due = false;
}

drive_stop drive_answers(drive_state *drive, bool braking)
{
    if (braking) {
        drive->mode = DRIVE_BACK;
        return STOP_NOTHING;
    }
    drive->back = true;
    return drive_power_off(drive);
}

bool drive_stop_done(drive_state *drive)
{
    bool back = drive->back;
    drive->stop = STOP_NOTHING;
    drive->enabled = 2;
    drive->back = false;
    drive->mode = back ? DRIVE_BACK : drive->mode;
    return back;
}

bool drive_is_off(const drive_last_off *off, bool reports_enabled, uint32_t enabled,
                  int64_t received_ns)
{
    if (off->first_ns == 0 || off->suffices) {
        return off->first_ns != 0;
    }
    return reports_enabled ? enabled == 0
                           : received_ns > off->first_ns && received_ns <= off->newest_ns;
}

/* ----------------------------------------------------------------------------- guarding */
bool drive_left_alone(int64_t last_ns, int64_t now_ns, int64_t watchdog_ns)
{
    return watchdog_ns > 0 && now_ns - last_ns > watchdog_ns;
}

bool drive_may_move(const drive_state *drive, bool fresh, bool enabled)
{
    return drive->mode == DRIVE_ARMED && fresh && enabled;
}

bool drive_has_to_rest(const drive_state *drive, bool wants_motion)
{
    return drive_is_cycled(drive) && drive->sent_motion && !wants_motion;
}

bool may_be_early(int64_t *early_ns, int64_t period_ns, int64_t now_ns)
{
    if (*early_ns - now_ns > (EARLY_AT_ONCE - 1) * period_ns) {
        return false;
    }
    *early_ns = (*early_ns > now_ns ? *early_ns : now_ns) + period_ns;
    return true;
}

/* Return the reason to disarm; 0: the drive stays armed. `was_enabled`: since it was armed. */
static uint32_t fault_reason(bool fresh, bool left_alone, bool enabled, bool was_enabled)
{
    if (!fresh) {
        return DRIVE_FAULT_SETPOINTS_OLD;
    }
    if (left_alone) {
        return DRIVE_FAULT_LEFT_ALONE;
    }
    return !enabled && was_enabled ? DRIVE_FAULT_NOT_ENABLED : 0;
}

/* Old set-points, or a drive that got nothing for its watchdog's time and may have stopped, cause a
 * quick stop. Set-points that are not enabled any more, or an unknown position, cause a
 * power-off. */
drive_stop drive_guard(drive_state *drive, const drive_view *view)
{
    if (drive->mode != DRIVE_ARMED) {
        return STOP_NOTHING;
    }
    bool was_enabled = drive->was_enabled || drive->enabled_count != view->enabled_count;
    uint32_t why = fault_reason(view->fresh, view->left_alone, view->enabled, was_enabled);
    if (why == 0 && view->position_unknown) {
        why = DRIVE_FAULT_POSITION_UNKNOWN;
    }
    if (why == DRIVE_FAULT_NOT_ENABLED || why == DRIVE_FAULT_POSITION_UNKNOWN) {
        drive_take_back(drive, why, DRIVE_READY);
        return drive_power_off(drive);
    }
    drive->was_enabled |= why == 0 && view->enabled;
    return why != 0 ? drive_quick_stop(drive, why, view->now_ns) : STOP_NOTHING;
}

drive_stop drive_check_power(drive_state *drive, uint32_t tries, bool settled)
{
    if (drive->mode == DRIVE_ARMED && drive->enabled == 0) {
        drive_take_back(drive, DRIVE_FAULT_DISABLED_ITSELF, DRIVE_OFF);
        return drive_power_off(drive);
    }
    if (drive->enabled == 0) {
        drive->still_enabled = 0;
    }
    bool enabled_unarmed = drive->mode == DRIVE_READY && drive->enabled == 1 && settled;
    if (!enabled_unarmed || drive->stopping || drive->stop != STOP_NOTHING) {
        return STOP_NOTHING;
    }
    drive->still_enabled++;
    drive->fault_reasons |= drive->still_enabled == tries ? DRIVE_FAULT_STILL_ENABLED : 0;
    return drive_power_off(drive);
}

/* ----------------------------------------------------------------------------- requests */
static void arm(drive_state *drive, const drive_view *view)
{
    drive->mode = DRIVE_ARMED;
    drive->was_enabled = false;
    drive->enabled_count = view->enabled_count;
    drive->fault_reasons = drive->still_enabled = 0;
    drive->enabled = 2;
}

static drive_request obey(drive_state *drive, uint32_t mode, bool stops, const drive_view *view)
{
    if (mode == DRIVE_OFF) {
        if (drive->mode == DRIVE_UNRESPONSIVE && !drive->back) {
            return REQUEST_SEEN; /* its probes stop it, and send the power-off that it is owed */
        }
        drive->mode = DRIVE_OFF;
        drive->back = false;
        return REQUEST_OFF;
    }
    if (mode == DRIVE_READY && (drive->mode == DRIVE_OFF || drive->mode == DRIVE_BACK)) {
        drive->mode = DRIVE_READY;
        drive->epoch++;
        drive->fault_reasons = drive->still_enabled = 0;
        drive->back = false;
        return REQUEST_SET_UP;
    }
    if (mode == DRIVE_ARMED && drive->mode == DRIVE_READY && view->fresh && !view->shut_down &&
        !stops) {
        if (view->position_unknown) {
            drive->fault_reasons |= DRIVE_FAULT_POSITION_UNKNOWN;
            return REQUEST_SEEN;
        }
        arm(drive, view);
        return REQUEST_ARM;
    }
    if (mode == DRIVE_STAND_DOWN && drive->mode == DRIVE_ARMED) {
        drive->mode = DRIVE_READY;
        drive->enabled = 2;
        return REQUEST_STAND_DOWN;
    }
    return REQUEST_SEEN;
}

/* A pending stop stays pending, whatever is requested after it. */
drive_answer drive_obey(drive_state *drive, const mode_request *request, const drive_view *view)
{
    drive_answer answer = {.request = REQUEST_NONE, .stop = STOP_NOTHING};
    if (request->count == drive->request_seen) {
        return answer;
    }
    answer.overtaken = request->count - drive->request_seen > 1;
    drive->request_seen = request->count;
    bool powered = drive->mode == DRIVE_ARMED || drive->mode == DRIVE_BACK || drive->back ||
                   drive->stopping || drive->sent_motion || drive->off_due;
    if ((answer.overtaken || request->mode == DRIVE_OFF) && powered) {
        drive->off_due = false;
        answer.stop = drive_power_off(drive);
    }
    if (answer.overtaken && drive->mode == DRIVE_ARMED) {
        drive->mode = DRIVE_READY;
        drive->enabled = 2;
    }
    bool stops = drive->stopping || drive->stop != STOP_NOTHING || answer.stop != STOP_NOTHING ||
                 drive->off_due;
    answer.request = obey(drive, request->mode, stops, view);
    return answer;
}
