/* The sleep of one who waits for the same slots again and again, and mostly in vain; included after
 * _waiting.h. What wait_any prepares for each sleep is prepared once, and a sleep in which nothing
 * happens runs no Python: after it the caches hold little of the program, and each line that it then
 * touches costs more than it does in a loop. */

typedef struct {
    PyObject_HEAD
    struct wait wait;    /* its board and ports are held */
    PyObject *woken;     /* as for wait_any */
    PyObject *own;       /* the pairs of `mine` */
    PyObject *otherwise; /* what is called unless all of a sleep was slept */
    struct { size_t number; Port *publisher; } *mine; /* what it adds to that slot is not waited for */
    size_t mine_number;
    long long duration_ns, until_ns;
} Doze;

static PyTypeObject *doze_type;

static bool doze_prepare(Doze *self, PyObject *seen)
{
    struct wait *wait = &self->wait;
    if (!wait_prepare(wait, seen))
        return false;
    for (size_t i = 0; i < wait->number; i++)
        memcpy(&wait->slots[i], &((Port *)wait->ports[i])->slot, offsetof(struct lwb_slot, own));
    size_t number = (size_t)PyTuple_Size(self->own);
    if (!(self->mine = PyMem_Calloc(number + 1, sizeof *self->mine)))
        return PyErr_NoMemory(); /* which is NULL */
    for (; self->mine_number < number; self->mine_number++) {
        PyObject *reader, *publisher, *pair = PyTuple_GetItem(self->own,
                                                              (Py_ssize_t)self->mine_number);
        if (!pair || !PyTuple_Check(pair)) {
            PyErr_SetString(PyExc_TypeError, "Doze() needs pairs of bound slots");
            return false;
        }
        if (!PyArg_ParseTuple(pair, "OO!", &reader, port_type, &publisher))
            return false;
        size_t i = 0;
        while (i < wait->number && wait->ports[i] != reader)
            i++;
        if (i == wait->number) {
            PyErr_SetString(PyExc_ValueError, "Doze() needs readers that it waits for");
            return false;
        }
        self->mine[self->mine_number].number = i;
        self->mine[self->mine_number].publisher = (Port *)publisher;
    }
    return true;
}

static PyObject *doze_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"", "", "", "", "", "", "", NULL};
    PyObject *board, *woken, *seen, *own, *otherwise;
    long long duration_ns, until_ns;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O!O!O!O!LLO", names, board_type, &board,
                                     &PyByteArray_Type, &woken, &PyDict_Type, &seen,
                                     &PyTuple_Type, &own, &duration_ns, &until_ns, &otherwise))
        return NULL;
    Doze *self = (Doze *)PyType_GenericAlloc(type, 0);
    if (!self)
        return NULL;
    self->wait.board = (Board *)Py_NewRef(board);
    self->woken = Py_NewRef(woken);
    self->own = Py_NewRef(own);
    self->otherwise = Py_NewRef(otherwise);
    self->duration_ns = duration_ns;
    self->until_ns = until_ns;
    if (is_open(self->wait.board, self->wait.board->path) && doze_prepare(self, seen))
        return (PyObject *)self;
    Py_DECREF(self);
    return NULL;
}

/* No tp_clear, for the reason that port_traverse has. */
static int doze_traverse(Doze *self, visitproc visit, void *arg)
{
    Py_VISIT(Py_TYPE((PyObject *)self));
    for (size_t i = 0; i < self->wait.number; i++)
        Py_VISIT(self->wait.ports[i]);
    Py_VISIT(self->own);
    Py_VISIT(self->otherwise);
    return 0;
}

static void doze_dealloc(Doze *self)
{
    PyTypeObject *type = Py_TYPE((PyObject *)self);
    PyObject_GC_UnTrack(self);
    wait_end(&self->wait);
    PyMem_Free(self->mine);
    Py_XDECREF(self->otherwise);
    Py_XDECREF(self->own);
    Py_XDECREF(self->woken);
    Py_XDECREF((PyObject *)self->wait.board);
    PyObject_GC_Del(self);
    Py_DECREF(type);
}

static long long monotonic_ns(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000LL + now.tv_nsec;
}

/* Sleep until then: 1 if all of it was slept, 0 if anything happened, -1 after an error. */
static int doze_sleep(Doze *self, long long deadline_ns)
{
    Board *board = self->wait.board;
    lwb_atomic32 *alarm = lwb_alarm(&board->board);
    for (;;) {
        uint32_t raised = atomic_load(alarm); /* before looking: what comes later raises it */
        long long left_ns = deadline_ns - monotonic_ns();
        if (PyByteArray_Size(self->woken) != 1 || PyByteArray_AsString(self->woken)[0])
            return 0;
        if (left_ns <= 0)
            return 1;
        board->users++;
        int status;
        Py_BEGIN_ALLOW_THREADS
        status = lwb_wait_any(alarm, raised, self->wait.awaited, self->wait.number,
                              (uint64_t)left_ns);
        Py_END_ALLOW_THREADS
        board_leave(board);
        if (PyErr_CheckSignals())
            return -1;
        if (status != LWB_TIMEOUT || board->closed)
            return 0;
    }
}

static PyObject *doze_once(Doze *self, PyObject *unused)
{
    (void)unused;
    Board *board = self->wait.board;
    long long now_ns = monotonic_ns(), deadline_ns = 0;
    if (now_ns < self->until_ns && !board->closed) {
        for (size_t i = 0; i < self->mine_number; i++) {
            uint64_t *after = &self->wait.awaited[self->mine[i].number].after;
            uint64_t added = self->mine[i].publisher->added;
            *after = *after > added ? *after : added;
        }
        deadline_ns = now_ns + self->duration_ns;
        int slept = doze_sleep(self, deadline_ns);
        if (slept < 0)
            return NULL;
        if (slept && lwb_linked(&board->board))
            Py_RETURN_TRUE;
        if (slept) /* the board was removed: who sleeps again gets an error */
            deadline_ns = 0;
    }
    return PyObject_CallFunction(self->otherwise, "L", deadline_ns);
}

static PyMethodDef doze_methods[] = {{"sleep", (PyCFunction)doze_once, METH_NOARGS, NULL},
                                     {NULL, NULL, 0, NULL}};

static PyType_Slot doze_slots[] = {
    {Py_tp_new, doze_new},
    {Py_tp_dealloc, doze_dealloc},
    {Py_tp_traverse, doze_traverse},
    {Py_tp_methods, doze_methods},
    {0, NULL}};

static PyType_Spec doze_spec = {
    .name = "llfsm.whiteboard._shm.Doze",
    .basicsize = sizeof(Doze),
    .flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .slots = doze_slots,
};
