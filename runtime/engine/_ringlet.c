/* The twins of ringlet.py and rotation.py, which define what is done here, and say why.
 *
 * What they need of a seat and of a state is in C structures, which the Python classes extend. All
 * that is rare is left to Python: requests, failures, accepting states, and turns that are timed or
 * observed. A field may be replaced, or its object end, whenever other code runs: what is used
 * after a call is held by a reference. Only the limited API of Python 3.11 is used. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdbool.h>
#include <stddef.h>
#include <structmember.h>

/* What a ringlet is doing, for whoever asks while it does. */
struct doing {
    PyObject *state; /* in which it began; borrowed, as the ringlet holds it */
    PyObject *code;  /* that it runs or has run last, or NULL in the snapshot */
    Py_ssize_t step; /* the number of its calls */
};

typedef struct {
    PyObject_HEAD
    PyObject *request, *machine, *sensors, *current, *previous, *source, *notifies, *suspension,
        *now, *entered_ns;
    struct doing *doing; /* NULL outside of ringlets */
} Seat;

typedef struct {
    PyObject_HEAD
    PyObject *on_entry, *on_exit, *internal, *on_suspend, *on_resume, *transitions;
} State;

typedef struct {
    PyObject_HEAD
    PyObject *turn, *leaving, *accept, *fail, *let_go;
} Rotation;

static PyTypeObject *seat_type, *state_type, *rotation_type;
static PyObject *plain_turn; /* the function `ringlet` of this module */
static PyObject *perform_request;

#define FIELD(type, name) {#name, T_OBJECT_EX, offsetof(type, name), 0, NULL}

static PyMemberDef seat_members[] = {
    FIELD(Seat, request),  FIELD(Seat, machine),    FIELD(Seat, sensors),  FIELD(Seat, current),
    FIELD(Seat, previous), FIELD(Seat, source),     FIELD(Seat, notifies), FIELD(Seat, suspension),
    FIELD(Seat, now),      FIELD(Seat, entered_ns), {NULL, 0, 0, 0, NULL}};

static PyMemberDef state_members[] = {
    FIELD(State, on_entry),   FIELD(State, on_exit),   FIELD(State, internal),
    FIELD(State, on_suspend), FIELD(State, on_resume), FIELD(State, transitions),
    {NULL, 0, 0, 0, NULL}};

static PyMemberDef rotation_members[] = {
    FIELD(Rotation, turn), FIELD(Rotation, leaving), FIELD(Rotation, accept),
    FIELD(Rotation, fail), FIELD(Rotation, let_go),  {NULL, 0, 0, 0, NULL}};

/* The garbage collector's view of an object whose fields are `members`. */

static PyObject **field(PyObject *self, const PyMemberDef *member)
{
    return (PyObject **)(void *)((char *)self + member->offset);
}

static int visit_fields(PyObject *self, const PyMemberDef *members, visitproc visit, void *arg)
{
    Py_VISIT(Py_TYPE(self));
    for (; members->name; members++)
        Py_VISIT(*field(self, members));
    return 0;
}

static int clear_fields(PyObject *self, const PyMemberDef *members)
{
    for (; members->name; members++)
        Py_CLEAR(*field(self, members));
    return 0;
}

static void end_fields(PyObject *self, const PyMemberDef *members)
{
    PyTypeObject *type = Py_TYPE(self);
    PyObject_GC_UnTrack(self);
    clear_fields(self, members);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(self);
    Py_DECREF(type);
}

#define COLLECTED(name)                                                                            \
    static int name##_traverse(PyObject *self, visitproc visit, void *arg)                         \
    {                                                                                              \
        return visit_fields(self, name##_members, visit, arg);                                     \
    }                                                                                              \
    static int name##_clear(PyObject *self) { return clear_fields(self, name##_members); }         \
    static void name##_dealloc(PyObject *self) { end_fields(self, name##_members); }

COLLECTED(seat)
COLLECTED(state)
COLLECTED(rotation)

/* The ringlet */

static bool is_none(PyObject *value) { return value == NULL || value == Py_None; }

static State *as_state(PyObject *value)
{
    if (value && PyObject_TypeCheck(value, state_type))
        return (State *)value;
    PyErr_SetString(PyExc_TypeError, "a seat's state must be a StateFields");
    return NULL;
}

static void put(PyObject **field, PyObject *value)
{
    PyObject *before = *field;
    *field = Py_NewRef(value);
    Py_XDECREF(before);
}

static PyObject *call(struct doing *doing, PyObject *code, PyObject *machine)
{
    doing->step++;
    put(&doing->code, code);
    return PyObject_CallFunctionObjArgs(code, machine, NULL);
}

static bool run(struct doing *doing, PyObject *code, PyObject *machine)
{
    if (is_none(code))
        return true;
    PyObject *result = call(doing, code, machine);
    Py_XDECREF(result);
    return result != NULL;
}

static bool take_snapshot(PyObject *sensors, PyObject *machine)
{
    Py_ssize_t number = PyTuple_Size(sensors);
    for (Py_ssize_t i = 0; i < number; i++) {
        PyObject *sensor = PyTuple_GetItem(sensors, i);
        PyObject *name = sensor ? PyTuple_GetItem(sensor, 0) : NULL;
        PyObject *read = name ? PyTuple_GetItem(sensor, 1) : NULL;
        PyObject *value = read ? PyObject_CallNoArgs(read) : NULL;
        if (!value)
            return false;
        int failed = PyObject_SetAttr(machine, name, value);
        Py_DECREF(value);
        if (failed)
            return false;
    }
    return number >= 0;
}

static bool enter(struct doing *doing, Seat *seat, State *state, PyObject *machine)
{
    PyObject *previous = seat->previous;
    PyObject *source = seat->source;
    seat->source = previous;
    seat->previous = Py_NewRef(state);
    Py_XDECREF(source);
    if (seat->notifies != Py_False) {
        State *before = NULL;
        if (!is_none(previous) && !(before = as_state(previous)))
            return false;
        Py_XINCREF(before);
        bool done = true;
        if ((PyObject *)state == seat->suspension)
            done = !before || run(doing, before->on_suspend, machine);
        else if (previous == seat->suspension)
            done = (!before || run(doing, before->on_resume, machine)) &&
                   run(doing, state->on_resume, machine);
        Py_XDECREF(before);
        if (!done)
            return false;
    }
    PyObject *now = seat->now ? PyObject_CallNoArgs(seat->now) : NULL;
    if (!now)
        return false;
    put(&seat->entered_ns, now);
    Py_DECREF(now);
    return run(doing, state->on_entry, machine);
}

static PyObject *look_up(const char *module_name, const char *name)
{
    PyObject *found = PyImport_ImportModule(module_name);
    PyObject *result = found ? PyObject_GetAttrString(found, name) : NULL;
    Py_XDECREF(found);
    return result;
}

/* 1 if a transition fired, 0 if none did, -1 after an error. */
static int evaluate(struct doing *doing, Seat *seat, State *state, PyObject *machine,
                    PyObject *transitions)
{
    Py_ssize_t number = PyTuple_Size(transitions);
    for (Py_ssize_t i = 0; i < number; i++) {
        PyObject *transition = PyTuple_GetItem(transitions, i);
        PyObject *guard = transition ? PyTuple_GetItem(transition, 0) : NULL;
        if (!guard)
            return -1;
        if (guard != Py_None) {
            PyObject *value = call(doing, guard, machine);
            Py_XDECREF(value);
            if (value == Py_False)
                continue;
            if (value != Py_True)
                return -1;
        }
        PyObject *target = PyTuple_GetItem(transition, 1);
        if (!target)
            return -1;
        put(&seat->current, target);
        return run(doing, state->on_exit, machine) ? 1 : -1;
    }
    if (number < 0)
        return -1;
    return run(doing, state->internal, machine) ? 0 : -1;
}

static int ringlet(Seat *seat)
{
    if (!is_none(seat->request)) {
        PyObject *done = PyObject_CallMethodObjArgs((PyObject *)seat, perform_request, NULL);
        Py_XDECREF(done);
        if (!done)
            return -1;
    }
    State *state = as_state(seat->current);
    if (!state)
        return -1;
    PyObject *machine = Py_NewRef(seat->machine);
    Py_INCREF(state);
    struct doing doing = {(PyObject *)state, NULL, 0}, *outer = seat->doing;
    seat->doing = &doing;
    int fired = -1;
    PyObject *sensors = Py_NewRef(seat->sensors);
    if (take_snapshot(sensors, machine) &&
        ((PyObject *)state == seat->previous || enter(&doing, seat, state, machine))) {
        PyObject *transitions = Py_NewRef(state->transitions);
        fired = evaluate(&doing, seat, state, machine, transitions);
        Py_DECREF(transitions);
    }
    Py_DECREF(sensors);
    seat->doing = outer;
    Py_DECREF(state);
    Py_XDECREF(doing.code);
    Py_DECREF(machine);
    return fired;
}

static PyObject *ringlet_of(PyObject *module, PyObject *seat)
{
    (void)module;
    if (!PyObject_TypeCheck(seat, seat_type)) {
        PyErr_SetString(PyExc_TypeError, "a ringlet needs a seat");
        return NULL;
    }
    int fired = ringlet((Seat *)seat);
    return fired < 0 ? NULL : PyBool_FromLong(fired);
}

static PyObject *rotation_run(PyObject *self_, PyObject *seats)
{
    Rotation *self = (Rotation *)self_;
    PyObject *turns = PyObject_GetIter(seats), *seat;
    bool any = false;
    while ((seat = PyIter_Next(turns))) {
        if (seat != Py_None) {
            int fired = ringlet((Seat *)seat);
            any |= fired == 1;
        }
        Py_DECREF(seat);
        if (PyList_Size(self->leaving)) break;
    }
    Py_DECREF(turns);
    return PyErr_Occurred() ? NULL : PyBool_FromLong(any);
}

static PyMethodDef rotation_methods[] = {{"run", rotation_run, METH_O, NULL}, {NULL, NULL, 0, NULL}};

#define SLOTS(name, ...)                                                                           \
    static PyType_Slot name##_slots[] = {                                                          \
        {Py_tp_members, name##_members}, {Py_tp_traverse, name##_traverse},                        \
        {Py_tp_clear, name##_clear}, {Py_tp_dealloc, name##_dealloc}, __VA_ARGS__ {0, NULL}};

SLOTS(seat, )
SLOTS(state, )
SLOTS(rotation, {Py_tp_methods, rotation_methods}, )

#define SPEC(name, Struct, text) static PyType_Spec name##_spec = {"llfsm.runtime.engine._ringlet." text, sizeof(Struct), 0, Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE | Py_TPFLAGS_HAVE_GC, name##_slots};
SPEC(seat, Seat, "SeatFields")
SPEC(state, State, "StateFields")
SPEC(rotation, Rotation, "Rotation")

static PyMethodDef functions[] = {{"ringlet", ringlet_of, METH_O, NULL}, {NULL, NULL, 0, NULL}};

static struct PyModuleDef module = {
    PyModuleDef_HEAD_INIT, .m_name = "_ringlet", .m_size = -1, .m_methods = functions};

PyMODINIT_FUNC PyInit__ringlet(void)
{
    PyObject *m = PyModule_Create(&module);
    perform_request = PyUnicode_InternFromString("perform_request");
    seat_type = (PyTypeObject *)PyType_FromSpec(&seat_spec);
    state_type = (PyTypeObject *)PyType_FromSpec(&state_spec);
    rotation_type = (PyTypeObject *)PyType_FromSpec(&rotation_spec);
    PyModule_AddType(m, seat_type);
    PyModule_AddType(m, state_type);
    PyModule_AddType(m, rotation_type);
    (void)plain_turn; (void)look_up;
    return m;
}
