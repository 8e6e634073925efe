/* The twin of `Rotation` in ringlet.py: turns one after the other, and rounds; included where ringlet
 * is known. */
#include <string.h>

static bool is_accepting(PyObject *seat)
{
    Record *state = is_one_of(&seats, seat) ? (Record *)((Record *)seat)->current : NULL;
    return state && is_one_of(&states, state) && PyTuple_Size(state->transitions) == 0;
}

/* Check that a machine has its turns behind those of the one whose state runs it. */
static bool is_inner(const Record *self, PyObject *seat)
{
    return self->nests == Py_True && is_one_of(&seats, seat) && ((Record *)seat)->inner == Py_True;
}

static bool give_turn(Record *self, PyObject *seat, bool *any);

/* Give what a machine's state runs their turns; some may leave on the way. */
static bool give_children_turns(Record *self, PyObject *seat, bool *any)
{
    const Record *outer = (Record *)seat;
    if (Py_EnterRecursiveCall(" in the turns of what a state runs"))
        return false;
    PyObject *children = hold(outer->children);
    Py_ssize_t number = children ? PyList_Size(children) : -1;
    bool done = number >= 0;
    for (Py_ssize_t i = 0; done && i < PyList_Size(children); i++) {
        PyObject *child = Py_NewRef(PyList_GetItem(children, i));
        done = child == Py_None || !is_inner(self, child) || give_turn(self, child, any);
        Py_DECREF(child);
    }
    Py_LeaveRecursiveCall();
    Py_XDECREF(children);
    return done;
}

/* Give a machine its turn and then, depth first, what its state runs. What comes of it is left to
 * Python. */
static bool give_turn(Record *self, PyObject *seat, bool *any)
{
    PyObject *rotation = (PyObject *)self;
    PyObject *fired = self->_turn == plain_turn ? ringlet(NULL, seat) : call(self->_turn, seat);
    bool done = is_done(fired);
    *any |= fired == Py_True;
    if (self->stopwatch != Py_None)
        done = take(self->stopwatch, seat, fired == Py_True) && done;
    if (done && fired == Py_False && is_accepting(seat))
        done = is_done(PyObject_CallMethod(rotation, "_accept", "O", seat));
    if (!done && PyErr_ExceptionMatches(execution_error)) {
        PyObject *error = take_error();
        done = is_done(PyObject_CallMethod(rotation, "fail", "OO", seat, error));
        Py_DECREF(error);
    }
    if (done && self->_leaving && PyList_Size(self->_leaving))
        done = is_done(PyObject_CallMethod(rotation, "_let_go", NULL));
    if (done && self->nests == Py_True && is_one_of(&seats, seat) &&
        ((Record *)seat)->children != Py_None)
        done = give_children_turns(self, seat, any);
    return done;
}

static PyObject *give_turns(PyObject *self, PyObject *turns)
{
    PyObject *iterator = PyObject_GetIter(turns), *seat;
    bool any = false, done = iterator;
    while (done && (seat = PyIter_Next(iterator))) {
        done = seat == Py_None || is_inner((Record *)self, seat) ||
               give_turn((Record *)self, seat, &any);
        Py_DECREF(seat);
    }
    Py_XDECREF(iterator);
    return PyErr_Occurred() ? NULL : PyBool_FromLong(any);
}

/* Give a round that nobody observes, and for whose time nobody waits. */
static PyObject *give_plain_round(PyObject *self, PyObject *turns)
{
    ((Record *)self)->rounds++;
    return give_turns(self, turns);
}

/* How machines stand: each seat, and what changes if it changes. The objects are held, so that no
 * other one can lie in the place of one that is gone. */
enum { MARKS = 7 };

static void get_marks(PyObject *object, PyObject *marks[MARKS])
{
    static const Record hole;
    const Record *seat = is_one_of(&seats, object) ? (Record *)object : &hole;
    PyObject *found[MARKS] = {object,        seat->current,    seat->previous,
                              seat->request, seat->entered_ns, seat->failure,
                              seat->hang};
    memcpy(marks, found, sizeof found);
}

static PyObject **hold_marks(PyObject *turns, Py_ssize_t number)
{
    PyObject **marks = PyMem_Calloc((size_t)number * MARKS + 1, sizeof *marks);
    for (Py_ssize_t i = 0; marks && i < number; i++)
        get_marks(PyList_GetItem(turns, i), marks + i * MARKS);
    for (Py_ssize_t i = 0; marks && i < number * MARKS; i++)
        Py_XINCREF(marks[i]);
    return marks ? marks : (PyObject **)PyErr_NoMemory();
}

static bool are_marks(PyObject *turns, PyObject **marks, Py_ssize_t number)
{
    bool same = PyList_Size(turns) == number;
    for (Py_ssize_t i = 0; same && i < number; i++) {
        PyObject *now[MARKS];
        get_marks(PyList_GetItem(turns, i), now);
        same = !memcmp(now, marks + i * MARKS, sizeof now);
    }
    return same;
}

/* Give a round: 1 if a transition fired, 0 if none did, -1 after an error or if none is wanted. */
static int give_round(Record *self, PyObject *turns)
{
    if (self->_gate != Py_None) {
        PyObject *begins = call(self->_gate, NULL);
        if (!is_done(begins) || begins != Py_True)
            return -1;
    }
    PyObject *fired = give_plain_round((PyObject *)self, turns);
    return is_done(fired) ? fired == Py_True : -1;
}

static PyObject *give_rounds(PyObject *object, PyObject *arguments)
{
    Record *self = (Record *)object;
    PyObject *turns, *sleep, *slept;
    if (!PyArg_ParseTuple(arguments, "O!O", &PyList_Type, &turns, &sleep))
        return NULL;
    Py_ssize_t number = PyList_Size(turns);
    PyObject **marks = hold_marks(turns, number), *turn = hold(self->_turn);
    int fired = -1;
    do {
        fired = marks && turn ? give_round(self, turns) : -1;
        slept = fired == 0 && self->_turn == turn && are_marks(turns, marks, number)
                    ? PyObject_CallNoArgs(sleep)
                    : NULL;
    } while (is_done(slept) && slept == Py_True);
    for (Py_ssize_t i = 0; marks && i < number * MARKS; i++)
        Py_XDECREF(marks[i]);
    PyMem_Free(marks);
    Py_XDECREF(turn);
    return PyErr_Occurred() ? NULL : PyBool_FromLong(fired == 1);
}

static PyMethodDef rotation_methods[] = {{"give_turns", give_turns, METH_O, NULL},
                                         {"give_round", give_plain_round, METH_O, NULL},
                                         {"give_rounds", give_rounds, METH_VARARGS, NULL},
                                         {"__class_getitem__", Py_GenericAlias,
                                          METH_O | METH_CLASS, NULL},
                                         {NULL, NULL, 0, NULL}};
static struct kind rotations = {.name = "llfsm.runtime.engine._ringlet.Rotation",
                                .fields = rotation_fields,
                                .methods = rotation_methods};
