/* Waiting for a port, and for any of several; included where Port is known. */

/* Wait for a message, and return what `found` returns for it unless that is None. */
static PyObject *port_await(Port *self, PyObject *args, PyObject *kwargs, PyCFunction found)
{
    static char *names[] = {"after", "timeout", NULL};
    PyObject *number = NULL, *timeout = Py_None;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "|$O!O", names, &PyLong_Type, &number,
                                     &timeout))
        return NULL;
    if (!number) {
        PyErr_SetString(PyExc_TypeError, "waiting needs the keyword 'after': a count");
        return NULL;
    }
    unsigned long long after = PyLong_AsUnsignedLongLong(number);
    if (PyErr_Occurred())
        return NULL;
    double seconds = timeout == Py_None ? HUGE_VAL : PyFloat_AsDouble(timeout);
    if (seconds == -1 && PyErr_Occurred())
        return NULL;
    struct timespec start;
    clock_gettime(CLOCK_MONOTONIC, &start);
    while (is_open(self->board, self->name)) {
        double left = seconds_left(&start, seconds);
        bool over = !(left > 0); /* NaN counts as over, too */
        int status;
        if (lwb_is_renamed(&self->slot)) {
            if ((status = port_renew(self, true)))
                return fail(status, self->name, NULL);
            after = 0; /* all messages are newer than those before */
        }
        port_begin_reading(self);
        struct lwb_slot slot = self->slot; /* another thread may renew it */
        self->board->users++;
        Py_BEGIN_ALLOW_THREADS
        status = lwb_wait(&slot, after, sleep_ns(left));
        Py_END_ALLOW_THREADS
        board_leave(self->board);
        if (PyErr_CheckSignals())
            return NULL;
        if (self->board->closed) /* by another thread: it may be unmapped, and the loop ends */
            continue;
        PyObject *what = status == LWB_OK ? found((PyObject *)self, NULL) : Py_NewRef(Py_None);
        if (what != Py_None) /* it is after a time-out, and if the slot has just been renamed */
            return what;
        Py_DECREF(what);
        if (over)
            Py_RETURN_NONE;
        if (!self->board->closed && !lwb_is_lost(&self->board->board) &&
            !lwb_linked(&self->board->board))
            return fail(REMOVED, self->name, NULL); /* no new process can open it and add */
    }
    return NULL;
}

static PyObject *port_wait(Port *self, PyObject *args, PyObject *kwargs)
{
    return port_await(self, args, kwargs, (PyCFunction)port_sample);
}

/* The count of the latest message, or None before the first. */
static PyObject *port_number(Port *self, PyObject *unused)
{
    (void)unused;
    uint64_t count = lwb_is_renamed(&self->slot) ? 0 : lwb_count(&self->slot);
    return count ? PyLong_FromUnsignedLongLong(count) : Py_NewRef(Py_None);
}

static PyObject *port_wait_count(Port *self, PyObject *args, PyObject *kwargs)
{
    return port_await(self, args, kwargs, (PyCFunction)port_number);
}

/* What one call of wait_any waits for: ports of `board`, which it holds, and for each what the protocol
 * needs. Slots are copies, as other threads may renew them during the wait. */
struct wait {
    Board *board;
    size_t number;
    PyObject **ports;
    struct lwb_awaited *awaited;
    struct lwb_slot *slots;
};

static bool wait_prepare(struct wait *self, PyObject *seen)
{
    size_t number = (size_t)PyDict_Size(seen);
    PyObject *port, *count;
    self->ports = PyMem_Calloc(number + 1, sizeof *self->ports);
    self->awaited = PyMem_Malloc((number + 1) * sizeof *self->awaited);
    self->slots = PyMem_Malloc((number + 1) * sizeof *self->slots);
    if (!self->ports || !self->awaited || !self->slots)
        return PyErr_NoMemory(); /* which is NULL */
    for (Py_ssize_t at = 0; PyDict_Next(seen, &at, &port, &count); self->number++) {
        if (Py_TYPE(port) != port_type || ((Port *)port)->board != self->board) {
            PyErr_SetString(PyExc_TypeError, "wait_any() needs the board's own bound slots");
            return false;
        }
        struct lwb_slot *slot = &self->slots[self->number];
        self->awaited[self->number] = (struct lwb_awaited){slot, PyLong_AsUnsignedLongLong(count)};
        if (PyErr_Occurred())
            return false;
        self->ports[self->number] = Py_NewRef(port);
    }
    return true;
}

static void wait_end(struct wait *self)
{
    for (size_t i = 0; i < self->number; i++)
        Py_DECREF(self->ports[i]);
    PyMem_Free(self->ports);
    PyMem_Free(self->awaited);
    PyMem_Free(self->slots);
}

/* The ports whose slot's count exceeds the awaited one, or is less, as it begins anew when a name was
 * given up; in `seen` they get their counts. */
static PyObject *newer_ports(struct wait *self, PyObject *seen)
{
    PyObject *list = PyList_New(0);
    for (size_t i = 0; list && i < self->number; i++) {
        Port *port = (Port *)self->ports[i];
        int status = port_renew(port, true);
        if (status) {
            fail(status, port->name, NULL);
            Py_CLEAR(list);
            break;
        }
        port_begin_reading(port);
        /* Without what only adds and reads need, which is nearly all of it. */
        memcpy(&self->slots[i], &port->slot, offsetof(struct lwb_slot, own));
        uint64_t count = self->awaited[i].after, now = lwb_count(&self->slots[i]);
        if (now > count || (now && now < count)) {
            PyObject *value = PyLong_FromUnsignedLongLong(now);
            if (!value || PyDict_SetItem(seen, self->ports[i], value) ||
                PyList_Append(list, self->ports[i]))
                Py_CLEAR(list);
            Py_XDECREF(value);
        }
    }
    return list;
}

/* Wait until `newer_ports` returns any, `woken` is not 0, or the time is over; return those ports. */
static PyObject *wait_for_any(struct wait *self, PyObject *seen, double seconds, PyObject *woken)
{
    struct timespec start;
    clock_gettime(CLOCK_MONOTONIC, &start);
    for (bool slept = false; is_open(self->board, self->board->path); slept = true) {
        lwb_atomic32 *alarm = lwb_alarm(&self->board->board);
        uint32_t raised = atomic_load(alarm); /* before looking: what comes later raises it */
        PyObject *list = newer_ports(self, seen);
        if (!list)
            return NULL;
        double left = seconds_left(&start, seconds);
        if (PyList_Size(list) || PyByteArray_AsString(woken)[0]) {
            PyByteArray_AsString(woken)[0] = 0;
            return list;
        }
        if (slept && !lwb_is_lost(&self->board->board) &&
            !lwb_linked(&self->board->board)) { /* no new process can open it and add */
            Py_DECREF(list);
            return fail(REMOVED, self->board->path, NULL);
        }
        if (!(left > 0))
            return list;
        Py_DECREF(list);
        self->board->users++;
        Py_BEGIN_ALLOW_THREADS
        lwb_wait_any(alarm, raised, self->awaited, self->number, sleep_ns(left));
        Py_END_ALLOW_THREADS
        board_leave(self->board);
        if (PyErr_CheckSignals())
            return NULL;
    }
    return NULL;
}

/* wait_any(board, woken, seen, timeout): waits for at most `timeout` seconds until the count of a port
 * of `board` exceeds the number that it has in the dictionary `seen`; returns a list of all such
 * ports, and puts their counts there. Returns early if the bytearray `woken` is not 0, which another
 * thread may set and then raise the alarm; resets it. */
static PyObject *wait_any(PyObject *module_, PyObject *const *arguments, Py_ssize_t number)
{
    (void)module_;
    if (number != 4 || (PyObject *)Py_TYPE(arguments[0]) != (PyObject *)board_type ||
        !PyByteArray_Check(arguments[1]) || !PyDict_Check(arguments[2]))
        return PyErr_Format(PyExc_TypeError,
                            "wait_any() needs a Board, a bytearray, a dict and seconds");
    if (PyByteArray_Size(arguments[1]) != 1)
        return PyErr_Format(PyExc_ValueError, "wait_any() needs a bytearray of one byte");
    double seconds = PyFloat_AsDouble(arguments[3]);
    if (seconds == -1 && PyErr_Occurred())
        return NULL;
    struct wait wait = {.board = (Board *)arguments[0]};
    PyObject *list = NULL;
    if (wait_prepare(&wait, arguments[2]))
        list = wait_for_any(&wait, arguments[2], seconds, arguments[1]);
    wait_end(&wait);
    return list;
}
