//
// State_Done_Suspending.h
//
// Automatically created through MiCASE -- do not change manually!
//
            class Done_Suspending: public CLState
            {
                class Transition_0: public CLTransition
                {
                public:
                    Transition_0(int toState = 4): CLTransition(toState) {}

                    virtual bool check(CLMachine *, CLState *) const;
                };

                CLTransition *_transitions[1];

                public:
                    Done_Suspending(const char *name = "Done_Suspending");

                    virtual int numberOfTransitions() const { return 1; }

#                   include "State_Done_Suspending_Variables.h"
            };
