/* The twins in statistics.py: count durations, and take what turns were like. */
#include "_records.h"

#include <errno.h>
#include <limits.h>
#include <sys/prctl.h>
#include <time.h>

enum { RANGES = 640 };
static const long long NEVER = LLONG_MIN;

static PyObject *monotonic_ns;

/* Return what the function in a field returns; without arguments if `argument` is NULL. */
static PyObject *call(PyObject *field, PyObject *argument)
{
    PyObject *function = hold(field);
    PyObject *result = function ? PyObject_CallFunctionObjArgs(function, argument, NULL) : NULL;
    Py_XDECREF(function);
    return result;
}

/* Drop a result. Functions of type bool return whether nothing was raised. */
static bool is_done(PyObject *result)
{
    Py_XDECREF(result);
    return result;
}

/* Read the clock in a field: most often the one that Python's time.monotonic_ns() reads. */
static bool read_clock(PyObject *field, long long *now_ns)
{
    if (field == monotonic_ns) {
        struct timespec now;
        clock_gettime(CLOCK_MONOTONIC, &now);
        *now_ns = now.tv_sec * 1000000000LL + now.tv_nsec;
        return true;
    }
    PyObject *now = call(field, NULL);
    *now_ns = now ? PyLong_AsLongLong(now) : 0;
    return is_done(now) && !PyErr_Occurred();
}

/* Sleep until a time of the monotonic clock; handlers of signals run meanwhile, and may raise.
 *
 * Linux lets a sleep last for 50 us longer, to wake fewer times: not if there is a time to keep. */
static PyObject *sleep_until_ns(PyObject *module, PyObject *deadline)
{
    (void)module;
    long long ns = PyLong_AsLongLong(deadline);
    if (ns == -1 && PyErr_Occurred())
        return NULL;
    struct timespec until = {ns > 0 ? ns / 1000000000 : 0, ns > 0 ? ns % 1000000000 : 0};
    int status;
    do {
        Py_BEGIN_ALLOW_THREADS
        prctl(PR_SET_TIMERSLACK, 1UL);
        status = clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
        prctl(PR_SET_TIMERSLACK, 0UL); /* the default */
        Py_END_ALLOW_THREADS
        if (PyErr_CheckSignals())
            return NULL;
    } while (status == EINTR);
    Py_RETURN_NONE;
}

/* Python may set the fields to any numbers. */
static long long minus(long long end_ns, long long begin_ns)
{
    return (long long)((unsigned long long)end_ns - (unsigned long long)begin_ns);
}

static bool is_wrong(const char *what)
{
    PyErr_Format(PyExc_TypeError, "%s is of another type", what);
    return false;
}

typedef struct {
    PyObject_HEAD
    long long total, longest_ns;
    long long counts[RANGES];
} Histogram;

static PyTypeObject *histogram_type;

/* Count a duration in the histogram of a field. */
static bool count(PyObject *field, long long ns)
{
    if (!field || Py_TYPE(field) != histogram_type)
        return is_wrong("a Histogram");
    Histogram *self = (Histogram *)field;
    ns = ns < 0 ? 0 : ns;
    int shift = ns < 32 ? 0 : 59 - __builtin_clzll((unsigned long long)ns);
    long long number = (shift << 4) + (ns >> shift); /* of ns >> shift the sixteens bit is set */
    self->counts[number < RANGES ? number : RANGES - 1]++;
    self->total++;
    self->longest_ns = ns > self->longest_ns ? ns : self->longest_ns;
    return true;
}

static PyObject *histogram_add(PyObject *self, PyObject *duration)
{
    long long ns = PyLong_AsLongLong(duration);
    if ((ns == -1 && PyErr_Occurred()) || !count(self, ns))
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *histogram_counts(PyObject *self, void *closure)
{
    (void)closure;
    PyObject *list = PyList_New(RANGES);
    for (Py_ssize_t i = 0; list && i < RANGES; i++) {
        PyObject *number = PyLong_FromLongLong(((Histogram *)self)->counts[i]);
        if (!number || PyList_SetItem(list, i, number))
            Py_CLEAR(list);
    }
    return list;
}

static PyMemberDef meter_fields[] = {
    FIELD(costs),     FIELD(jitters),           NUMBER(fired),
    NUMBER(overruns), NUMBER(worst_overrun_ns), NUMBER(since_ns),
    NUMBER(late_ns),  {NULL, 0, 0, 0, NULL}};
static struct kind meters = {.name = "llfsm.runtime.engine._ringlet.MeterFields",
                             .fields = meter_fields,
                             .methods = no_methods};

/* Count the time in the state before, if the seat has come into another one. */
static bool take_state(Record *seat, Record *meter, long long begin_ns)
{
    Record *state = (Record *)(seat->previous == Py_None ? seat->current : seat->previous);
    Record *before = (Record *)seat->timed;
    if (state == before)
        return true;
    bool is_first = seat->timed == Py_None;
    if (!before || !state)
        return hold(NULL);
    if (!is_one_of(&states, state) || (!is_first && !is_one_of(&states, before)))
        return is_wrong("a seat's state");
    if (!is_first)
        before->spent_ns += minus(begin_ns, meter->since_ns);
    if (state->spent_ns < 0)
        state->spent_ns = 0;
    put(&seat->timed, state);
    meter->since_ns = begin_ns;
    return true;
}

/* Compare a turn with its plan. */
static bool take_plan(const Record *self, Record *meter, long long begin_ns)
{
    long long late_ns = minus(begin_ns, self->due_ns), change_ns = minus(late_ns, meter->late_ns);
    if (meter->late_ns != NEVER && !count(meter->jitters, change_ns < 0 ? minus(0, change_ns) : change_ns))
        return false;
    meter->late_ns = late_ns;
    long long overrun_ns = minus(self->begin_ns, self->deadline_ns);
    meter->overruns += overrun_ns > 0;
    if (overrun_ns > meter->worst_overrun_ns)
        meter->worst_overrun_ns = overrun_ns;
    return true;
}

static bool take_turn(Record *self, PyObject *object, bool fired)
{
    Record *seat = (Record *)object, *meter;
    long long begin_ns = self->begin_ns;
    if (!is_one_of(&seats, seat))
        return is_wrong("a seat");
    if (!read_clock(self->now, &self->begin_ns))
        return false;
    if (seat->meter == Py_None &&
        !is_done(PyObject_CallMethod((PyObject *)self, "_meter_of", "O", object)))
        return false;
    if (!(meter = (Record *)seat->meter) || !is_one_of(&meters, meter))
        return is_wrong("a seat's meter");
    meter->fired += fired;
    return count(meter->costs, minus(self->begin_ns, begin_ns)) &&
           take_state(seat, meter, begin_ns) &&
           (self->deadline_ns == NEVER || take_plan(self, meter, begin_ns));
}

static PyObject *timing_begin(PyObject *self, PyObject *nothing)
{
    (void)nothing;
    return read_clock(((Record *)self)->now, &((Record *)self)->begin_ns) ? Py_NewRef(Py_True)
                                                                         : NULL;
}

static PyObject *timing_begin_due(PyObject *object, PyObject *const *arguments, Py_ssize_t number)
{
    Record *self = (Record *)object;
    if (number != 3)
        return PyErr_Format(PyExc_TypeError, "begin_due takes 3 arguments");
    if (!read_clock(self->now, &self->begin_ns))
        return NULL;
    self->due_ns = PyLong_AsLongLong(arguments[0]);
    self->deadline_ns = PyLong_AsLongLong(arguments[1]);
    if (PyErr_Occurred() || !count(arguments[2], minus(self->begin_ns, self->due_ns)))
        return NULL;
    Py_RETURN_NONE;
}

static PyObject *timing_take(PyObject *self, PyObject *arguments)
{
    PyObject *seat;
    int fired;
    if (!PyArg_ParseTuple(arguments, "Op", &seat, &fired) ||
        !take_turn((Record *)self, seat, fired))
        return NULL;
    Py_RETURN_NONE;
}

static PyMethodDef timing_methods[] = {
    {"begin", timing_begin, METH_NOARGS, NULL},
    {"begin_due", (PyCFunction)(void (*)(void))timing_begin_due, METH_FASTCALL, NULL},
    {"take", timing_take, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL}};
static PyMemberDef timing_fields[] = {FIELD(now), NUMBER(begin_ns), NUMBER(due_ns),
                                      NUMBER(deadline_ns), {NULL, 0, 0, 0, NULL}};
static struct kind timings = {.name = "llfsm.runtime.engine._ringlet.Timing",
                              .fields = timing_fields,
                              .methods = timing_methods};

/* Take a turn that is over, maybe by an error, which stays set. */
static bool take(PyObject *field, PyObject *seat, bool fired)
{
    PyObject *type, *error, *traceback;
    PyErr_Fetch(&type, &error, &traceback);
    Record *self = hold(field);
    bool done = self && (is_one_of(&timings, self) || is_wrong("a stopwatch")) &&
                take_turn(self, seat, fired);
    Py_XDECREF((PyObject *)self);
    if (done) {
        PyErr_Restore(type, error, traceback);
        return true;
    }
    Py_XDECREF(type);
    Py_XDECREF(error);
    Py_XDECREF(traceback);
    return false;
}

/* Make the types and add them to the module. */
static bool add_timing(PyObject *module)
{
    static PyMethodDef methods[] = {{"add", histogram_add, METH_O, NULL}, {NULL, NULL, 0, NULL}};
    static PyGetSetDef properties[] = {{"counts", histogram_counts, NULL, NULL, NULL},
                                       {NULL, NULL, NULL, NULL, NULL}};
    static PyMemberDef fields[] = {
        {"total", T_LONGLONG, offsetof(Histogram, total), READONLY, NULL},
        {"longest_ns", T_LONGLONG, offsetof(Histogram, longest_ns), READONLY, NULL},
        {NULL, 0, 0, 0, NULL}};
    PyType_Slot slots[] = {
        {Py_tp_members, fields}, {Py_tp_methods, methods}, {Py_tp_getset, properties}, {0, NULL}};
    PyType_Spec spec = {"llfsm.runtime.engine._ringlet.Histogram", sizeof(Histogram), 0,
                        Py_TPFLAGS_DEFAULT, slots};
    histogram_type = (PyTypeObject *)PyType_FromSpec(&spec);
    return histogram_type && !PyModule_AddType(module, histogram_type) &&
           add_type(module, &meters) && add_type(module, &timings);
}
