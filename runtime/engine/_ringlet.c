/* The twin of ringlet.py, which defines what is done, and numbers the steps.
 *
 * Whatever is rare is left to Python: requests, failures, accepting, and observed turns. Code
 * that is called may replace any field: what is used after a call is held by a reference. Nothing
 * but the limited API of Python 3.11 is used. */
#include "_timing.h"

/* A ringlet under way, which holds references to all but the seat. */
struct ringlet {
    Record *seat, *state; /* the state in which it began */
    PyObject *machine;
    PyObject *code; /* what it runs, or has run last; NULL in the snapshot */
    long long step; /* the number of that call */
};

static long long calls; /* of code, and ringlets begun, so far */
static PyObject *plain_turn, *execution_error;

/* Clear the error that is set, and return it. */
static PyObject *take_error(void)
{
    PyObject *type, *error, *traceback;
    PyErr_Fetch(&type, &error, &traceback);
    PyErr_NormalizeException(&type, &error, &traceback);
    if (traceback)
        PyException_SetTraceback(error, traceback);
    Py_XDECREF(traceback);
    Py_DECREF(type);
    return error;
}

/* Raise the error that a method of the seat makes of a value, or of another error. */
static void raise_failure(const struct ringlet *self, const char *method, PyObject *value)
{
    PyObject *error = PyObject_CallMethod((PyObject *)self->seat, method, "OOO", self->state,
                                          self->code ? self->code : Py_None, value);
    if (error)
        PyErr_SetObject((PyObject *)Py_TYPE(error), error);
    Py_XDECREF(error);
}

static PyObject *call_code(struct ringlet *self, PyObject *code)
{
    self->step = ++calls;
    put(&self->code, code);
    return PyObject_CallFunctionObjArgs(code, self->machine, NULL);
}

static inline bool run_section(struct ringlet *self, PyObject *code)
{
    return code == Py_None || is_done(code ? call_code(self, code) : hold(code));
}

/* Borrow the three items of a row of a table. */
static inline bool get_row(PyObject *table, Py_ssize_t number, PyObject *items[3])
{
    PyObject *row = PyTuple_GetItem(table, number);
    for (int i = 0; i < 3; i++)
        if (!row || !(items[i] = PyTuple_GetItem(row, i)))
            return false;
    return true;
}

static bool take_snapshot(struct ringlet *self, PyObject *sensors) /* 2 */
{
    Py_ssize_t number = PyTuple_Size(sensors);
    bool done = number >= 0;
    for (Py_ssize_t i = 0; done && i < number; i++) {
        PyObject *items[3]; /* name, reader, default */
        PyObject *value = get_row(sensors, i, items) ? PyObject_CallNoArgs(items[1]) : NULL;
        done = value && !PyObject_SetAttr(self->machine, items[0],
                                          value == Py_None ? items[2] : value);
        Py_XDECREF(value);
    }
    return done;
}

static bool notify(struct ringlet *self, Record *previous) /* 3 */
{
    const Record *seat = self->seat, *suspension = (Record *)seat->suspension;
    if (seat->notifies != Py_True || !is_one_of(&states, previous))
        return true;
    if (self->state == suspension)
        return run_section(self, previous->on_suspend);
    return previous != suspension || (run_section(self, previous->on_resume) &&
                                      run_section(self, self->state->on_resume));
}

static bool enter(struct ringlet *self) /* 4 */
{
    Record *seat = self->seat, *previous = hold(seat->previous);
    if (!previous)
        return false;
    put(&seat->previous, self->state);
    put(&seat->source, previous);
    PyObject *now = notify(self, previous) ? call(seat->now, NULL) : NULL;
    if (now)
        put(&seat->entered_ns, now);
    Py_DECREF((PyObject *)previous);
    return is_done(now) && run_section(self, self->state->on_entry);
}

/* 1 if more time has passed in the state, 0 if not, -1 after an error. */
static int is_later(const Record *seat, PyObject *limit)
{
    long long now_ns, entered_ns, passed_ns, limit_ns = PyLong_AsLongLong(limit);
    if (!read_clock(seat->now, &now_ns))
        return -1;
    entered_ns = seat->entered_ns ? PyLong_AsLongLong(seat->entered_ns) : -1;
    if ((entered_ns == -1 || limit_ns == -1) && PyErr_Occurred())
        return -1;
    return __builtin_sub_overflow(now_ns, entered_ns, &passed_ns) || passed_ns > limit_ns;
}

/* 1 if the guard returns True, 0 if False, -1 after an error. */
static int holds(struct ringlet *self, PyObject *guard)
{
    PyObject *value = call_code(self, guard);
    int truth = value == Py_True ? 1 : value == Py_False ? 0 : -1;
    if (value && truth < 0)
        raise_failure(self, "not_a_bool", value);
    Py_XDECREF(value);
    return truth;
}

/* 1 if a transition fired, 0 if none did, -1 after an error. */
static int evaluate(struct ringlet *self, PyObject *transitions) /* 5 and 6 */
{
    Py_ssize_t number = PyTuple_Size(transitions);
    for (Py_ssize_t i = 0; i < number; i++) {
        PyObject *items[3]; /* time, guard, target */
        int fires = get_row(transitions, i, items) ? 1 : -1;
        if (fires == 1 && items[0] != Py_None)
            fires = is_later(self->seat, items[0]);
        if (fires == 1 && items[1] != Py_None)
            fires = holds(self, items[1]);
        if (fires == 1)
            put(&self->seat->current, items[2]);
        if (fires)
            return fires == 1 && run_section(self, self->state->on_exit) ? 1 : -1;
    }
    return number >= 0 && run_section(self, self->state->internal) ? 0 : -1;
}

static int take_steps(struct ringlet *self)
{
    PyObject *sensors = hold(self->seat->sensors), *transitions = NULL;
    int fired = -1;
    if (sensors && take_snapshot(self, sensors) &&
        (self->seat->previous == (PyObject *)self->state || enter(self)) &&
        (transitions = hold(self->state->transitions)))
        fired = evaluate(self, transitions);
    Py_XDECREF(sensors);
    Py_XDECREF(transitions);
    return fired;
}

static PyObject *ringlet(PyObject *module, PyObject *object)
{
    (void)module;
    Record *seat = (Record *)object;
    if (!is_one_of(&seats, seat))
        return PyErr_Format(PyExc_TypeError, "a ringlet is one of a seat, not of %R", object);
    if (seat->request != Py_None && /* 1 */
        !is_done(PyObject_CallMethod(object, "perform_request", NULL)))
        return NULL;
    struct ringlet self = {seat, hold(seat->current), hold(seat->machine), NULL, ++calls};
    const struct ringlet *outer = seat->running;
    int fired = -1;
    if (self.state && self.machine && is_one_of(&states, self.state)) {
        seat->running = &self;
        fired = take_steps(&self);
        seat->running = outer;
        if (fired < 0) {
            PyObject *error = take_error();
            raise_failure(&self, "explain", error);
            Py_DECREF(error);
        }
    } else if (!PyErr_Occurred()) {
        PyErr_Format(PyExc_TypeError, "the state of a seat cannot be %R", self.state);
    }
    Py_XDECREF((PyObject *)self.state);
    Py_XDECREF(self.machine);
    Py_XDECREF(self.code);
    return fired < 0 ? NULL : PyBool_FromLong(fired);
}

static PyObject *running(PyObject *module, PyObject *seat)
{
    (void)module;
    const struct ringlet *now = is_one_of(&seats, seat) ? ((Record *)seat)->running : NULL;
    if (!now)
        Py_RETURN_NONE;
    return Py_BuildValue("OOL", now->state, now->code ? now->code : Py_None, now->step);
}

#include "_rotation.h"

static PyMethodDef functions[] = {{"ringlet", ringlet, METH_O, NULL},
                                  {"running", running, METH_O, NULL},
                                  {"sleep_until_ns", sleep_until_ns, METH_O, NULL},
                                  {NULL, NULL, 0, NULL}};
static struct PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, .m_name = "_ringlet", .m_size = -1, .m_methods = functions};

static PyObject *look_up(const char *module, const char *name)
{
    PyObject *found = PyImport_ImportModule(module);
    PyObject *result = found ? PyObject_GetAttrString(found, name) : NULL;
    Py_XDECREF(found);
    return result;
}

PyMODINIT_FUNC PyInit__ringlet(void)
{
    PyObject *module = PyModule_Create(&definition);
    if (!module ||
        !(execution_error = look_up("llfsm.runtime.engine.errors", "ExecutionError")) ||
        !(monotonic_ns = look_up("time", "monotonic_ns")) ||
        !(plain_turn = PyObject_GetAttrString(module, "ringlet")) ||
        !add_type(module, &seats) || !add_type(module, &states) ||
        !add_type(module, &rotations) || !add_timing(module))
        Py_CLEAR(module);
    return module;
}
