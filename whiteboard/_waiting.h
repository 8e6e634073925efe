/* Waiting for a port, and for any of several; included where Port is known. */

static PyObject *port_wait(Port *self, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"after", "timeout", NULL};
    PyObject *number = NULL, *timeout = Py_None;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "|$O!O", names, &PyLong_Type, &number,
                                     &timeout))
        return NULL;
    if (!number) {
        PyErr_SetString(PyExc_TypeError, "wait() needs the keyword 'after': a count");
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
        self->board->users++;
        Py_BEGIN_ALLOW_THREADS
        status = lwb_wait(&self->slot, after, sleep_ns(left));
        Py_END_ALLOW_THREADS
        board_leave(self->board);
        if (PyErr_CheckSignals())
            return NULL;
        if (status == LWB_OK)
            return port_sample(self, NULL);
        if (over)
            Py_RETURN_NONE;
        if (!self->board->closed && !lwb_linked(&self->board->board))
            return fail(REMOVED, self->name, NULL); /* no new process can open it and add */
    }
    return NULL;
}

/* The ports of the dictionary `before` whose slot's count exceeds their value, as a list; in `seen`
 * they get their counts. All must be of `board`, whose alarm wakes; `awaited` becomes what the
 * protocol needs to wait for them. */
static PyObject *newer_ports(Board *board, PyObject *before, PyObject *seen,
                             struct lwb_awaited *awaited)
{
    PyObject *list = PyList_New(0), *port, *number;
    for (Py_ssize_t at = 0, i = 0; list && PyDict_Next(before, &at, &port, &number); i++) {
        uint64_t count = PyLong_AsUnsignedLongLong(number);
        if (Py_TYPE(port) != port_type || ((Port *)port)->board != board)
            PyErr_SetString(PyExc_TypeError, "wait_any() needs the board's own bound slots");
        if (PyErr_Occurred()) {
            Py_CLEAR(list);
            break;
        }
        awaited[i] = (struct lwb_awaited){&((Port *)port)->slot, count};
        uint64_t now = lwb_count(awaited[i].slot);
        if (now > count) {
            PyObject *value = PyLong_FromUnsignedLongLong(now);
            if (!value || PyDict_SetItem(seen, port, value) || PyList_Append(list, port))
                Py_CLEAR(list);
            Py_XDECREF(value);
        }
    }
    return list;
}

/* wait_any(board, seen, timeout, woken): waits for at most `timeout` seconds until the count of a port
 * of `board` exceeds the number that it has in the dictionary `seen`; returns a list of all such
 * ports, and puts their counts there. Returns early if the bytearray `woken` is not 0, which another thread may set and
 * then raise the alarm; resets it. */
static PyObject *wait_any(PyObject *module_, PyObject *args)
{
    (void)module_;
    Board *board;
    PyObject *seen, *woken;
    double seconds;
    if (!PyArg_ParseTuple(args, "O!O!dO!", board_type, &board, &PyDict_Type, &seen, &seconds,
                          &PyByteArray_Type, &woken))
        return NULL;
    if (PyByteArray_Size(woken) != 1) {
        PyErr_SetString(PyExc_ValueError, "wait_any() needs a bytearray of one byte");
        return NULL;
    }
    struct timespec start;
    clock_gettime(CLOCK_MONOTONIC, &start);
    PyObject *before = PyDict_Copy(seen), *list = NULL; /* which keeps the ports */
    size_t number = before ? (size_t)PyDict_Size(before) : 0;
    struct lwb_awaited *awaited = before ? PyMem_Calloc(number + 1, sizeof *awaited) : NULL;
    if (before && !awaited)
        PyErr_NoMemory();
    while (awaited && is_open(board, board->path)) {
        lwb_atomic32 *alarm = lwb_alarm(&board->board);
        uint32_t raised = atomic_load(alarm); /* before looking: what comes later raises it */
        if (!(list = newer_ports(board, before, seen, awaited)))
            break;
        double left = seconds_left(&start, seconds);
        if (PyList_Size(list) || PyByteArray_AsString(woken)[0] || !(left > 0)) {
            PyByteArray_AsString(woken)[0] = 0;
            break;
        }
        Py_CLEAR(list);
        board->users++;
        Py_BEGIN_ALLOW_THREADS
        lwb_wait_any(alarm, raised, awaited, number, sleep_ns(left));
        Py_END_ALLOW_THREADS
        board_leave(board);
        if (PyErr_CheckSignals())
            break;
    }
    PyMem_Free(awaited);
    Py_XDECREF(before);
    return list;
}
