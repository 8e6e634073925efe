/* Waiting for any of several ports; included where Port is known. */

/* The ports of the dictionary `after` whose slot's count exceeds their value, as a list. All must be
 * of `board`, whose alarm wakes; `awaited` becomes what the protocol needs to wait for them. */
static PyObject *newer_ports(Board *board, PyObject *after, struct lwb_awaited *awaited)
{
    PyObject *list = PyList_New(0), *port, *number;
    for (Py_ssize_t at = 0, i = 0; list && PyDict_Next(after, &at, &port, &number); i++) {
        uint64_t count = PyLong_AsUnsignedLongLong(number);
        if (Py_TYPE(port) != port_type || ((Port *)port)->board != board)
            PyErr_SetString(PyExc_TypeError, "wait_any() needs the board's own bound slots");
        if (PyErr_Occurred()) {
            Py_CLEAR(list);
            break;
        }
        awaited[i] = (struct lwb_awaited){&((Port *)port)->slot, count};
        if (lwb_count(awaited[i].slot) > count && PyList_Append(list, port))
            Py_CLEAR(list);
    }
    return list;
}

/* wait_any(board, after, timeout, woken): waits for at most `timeout` seconds until the count of a
 * port of `board` exceeds the number that it has in the dictionary `after`; returns a list of all
 * such ports. Returns early if the bytearray `woken` is not 0, which another thread may set and
 * then raise the alarm; resets it. */
static PyObject *wait_any(PyObject *module_, PyObject *args)
{
    (void)module_;
    Board *board;
    PyObject *given, *woken;
    double seconds;
    if (!PyArg_ParseTuple(args, "O!O!dO!", board_type, &board, &PyDict_Type, &given, &seconds,
                          &PyByteArray_Type, &woken))
        return NULL;
    if (PyByteArray_Size(woken) != 1) {
        PyErr_SetString(PyExc_ValueError, "wait_any() needs a bytearray of one byte");
        return NULL;
    }
    struct timespec start;
    clock_gettime(CLOCK_MONOTONIC, &start);
    PyObject *after = PyDict_Copy(given), *list = NULL; /* others may change theirs meanwhile */
    size_t number = after ? (size_t)PyDict_Size(after) : 0;
    struct lwb_awaited *awaited = after ? PyMem_Calloc(number + 1, sizeof *awaited) : NULL;
    if (after && !awaited)
        PyErr_NoMemory();
    while (awaited && is_open(board, board->path)) {
        lwb_atomic32 *alarm = lwb_alarm(&board->board);
        uint32_t seen = atomic_load(alarm); /* before looking: what comes after that raises it */
        if (!(list = newer_ports(board, after, awaited)))
            break;
        double left = seconds_left(&start, seconds);
        if (PyList_Size(list) || PyByteArray_AsString(woken)[0] || !(left > 0)) {
            PyByteArray_AsString(woken)[0] = 0;
            break;
        }
        Py_CLEAR(list);
        board->users++;
        Py_BEGIN_ALLOW_THREADS
        lwb_wait_any(alarm, seen, awaited, number, sleep_ns(left));
        Py_END_ALLOW_THREADS
        board_leave(board);
        if (PyErr_CheckSignals())
            break;
    }
    PyMem_Free(awaited);
    Py_XDECREF(after);
    return list;
}
